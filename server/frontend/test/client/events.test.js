import assert from "node:assert/strict";
import { test } from "node:test";

import { EventReader } from "../../src/client/feed.js";

const bytes = (text) => new TextEncoder().encode(text);

test("events come out whole, however the bytes are cut", () => {
  const reader = new EventReader();
  const stream = bytes('event: robot\ndata: {"name":"söm"}\n\nevent: removed\ndata: {}\n\n');
  const found = [...stream].flatMap((byte) => reader.push(Uint8Array.of(byte)));
  assert.deepEqual(found, [
    { name: "robot", data: '{"name":"söm"}' },
    { name: "removed", data: "{}" },
  ]);
});

test("a comment is no event", () => {
  assert.deepEqual(new EventReader().push(bytes(": awake\n\n")), []);
});
