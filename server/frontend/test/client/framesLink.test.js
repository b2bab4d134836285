import assert from "node:assert/strict";
import { test } from "node:test";

import { readFrame } from "../../src/client/framesLink.js";
import { framed } from "./fakes.js";

test("a picture is taken out with its number, quality and moment, without a copy", () => {
  const data = framed({ number: 4_000_000_000, quality: 70, flags: 1, timestampMs: 5123456.75, jpeg: [1, 2, 3] });
  const frame = readFrame(data);
  assert.deepEqual(
    { ...frame, jpeg: [...frame.jpeg] },
    { number: 4_000_000_000, quality: 70, byCamera: true, timestampMs: 5123456.75, jpeg: [1, 2, 3] },
  );
  assert.equal(frame.jpeg.buffer, data);
});

test("other codecs, moments that are no number and too short messages are none", () => {
  assert.equal(readFrame(framed({ codec: 2 })), null);
  assert.equal(readFrame(framed({ timestampMs: NaN })), null);
  assert.equal(readFrame(framed({ jpeg: [] })), null);
  assert.equal(readFrame(new ArrayBuffer(3)), null);
});
