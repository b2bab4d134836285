import assert from "node:assert/strict";
import { test } from "node:test";

import { MultipartReader, boundaryOf } from "../src/multipart.js";

const bytes = (text) => new TextEncoder().encode(text);
const texts = (frames) => frames.map((frame) => new TextDecoder().decode(frame));

const part = (body, length = true) =>
  `--b\r\nContent-Type: image/jpeg\r\n${length ? `Content-Length: ${body.length}\r\n` : ""}\r\n${body}\r\n`;

test("frames come out whole, however the network cut the bytes", () => {
  const stream = bytes(part("one") + part("tw\r\n--b\r\no") + part("three"));
  for (const size of [1, 2, 7, stream.length]) {
    const reader = new MultipartReader("b");
    const frames = [];
    for (let i = 0; i < stream.length; i += size) frames.push(...reader.push(stream.slice(i, i + size)));
    assert.deepEqual(texts(frames), ["one", "tw\r\n--b\r\no", "three"], `pieces of ${size}`);
  }
});

test("a part without a length ends at the boundary", () => {
  const reader = new MultipartReader("b");
  assert.deepEqual(texts(reader.push(bytes(part("one", false) + part("two", false) + "--b"))), ["one", "two"]);
});

test("a body that is no multipart stream is refused instead of collected", () => {
  const reader = new MultipartReader("b");
  assert.throws(() => reader.push(new Uint8Array(20_000)), /no multipart stream/);
});

test("a frame without end is refused at 10 MB", () => {
  const reader = new MultipartReader("b");
  reader.push(bytes("--b\r\nContent-Length: 99999999\r\n\r\n"));
  assert.throws(() => reader.push(new Uint8Array(11 * 1024 * 1024)), /10 MB/);
});

test("the boundary is read with and without quotes and leading dashes", () => {
  const type = "multipart/x-mixed-replace";
  assert.equal(boundaryOf(`${type};boundary=boundarydonotcross`), "boundarydonotcross");
  assert.equal(boundaryOf(`${type}; charset=x; boundary="--frame"`), "frame");
  assert.equal(boundaryOf("text/html"), null);
  assert.equal(boundaryOf(null), null);
});
