import assert from "node:assert/strict";
import { test } from "node:test";

import { CdrError, decoderOf } from "../../src/replay/cdr.js";

const LINE = `${"=".repeat(80)}\n`;
const TIME = `${LINE}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n`;
const HEADER = `${LINE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n`;
const PART = `${LINE}MSG: demo/Part\nstring name\nint16 small\n`;
const ALL = `bool flag\nstd_msgs/Header header  # where\nint8[] cells\nfloat32[2] ranges\nuint64 big\ndemo/Part[] parts\n${HEADER}${PART}${TIME}`;
const bytes = (hex) => Uint8Array.from(Buffer.from(hex.replaceAll(" ", ""), "hex"));
// As server/robotether_server/recorder/cdr.py writes it.
const MESSAGE = bytes(
  "00010000 01000000 01000000 02000000 04000000 6d617000 02000000 ff640000 0000c03f 0000c07f 00000000 00000000" +
    "00010000 02000000 02000000 7800feff 01000000 00000300",
);

test("a message is read as the recorder writes it", () => {
  const message = decoderOf("demo/msg/All", ALL)(MESSAGE);
  assert.equal(message.flag, true);
  assert.deepEqual({ ...message.header.stamp, frame: message.header.frame_id }, { sec: 1, nanosec: 2, frame: "map" });
  assert.deepEqual([...message.cells], [-1, 100]);
  assert.deepEqual(message.ranges, [1.5, NaN]);
  assert.equal(message.big, 2 ** 40);
  assert.deepEqual(
    message.parts.map(({ name, small }) => `${name} ${small}`),
    ["x -2", " 3"],
  );
});

test("a message that is cut anywhere is refused", () => {
  const decode = decoderOf("demo/msg/All", ALL);
  for (let size = 0; size < MESSAGE.length; size++) assert.throws(() => decode(MESSAGE.subarray(0, size)), CdrError);
});

for (const [what, definition, hex] of [
  ["a sequence that says it is enormous", "float64[] data\n", "00010000 ffffffff"],
  ["a text that says it is enormous", "string data\n", "00010000 ffffffff 41"],
  ["an array that the definition makes enormous", "uint8[4000000000] data\n", "00010000 00"],
  ["a type that is a part of itself", `demo/All next\n${LINE}MSG: demo/All\ndemo/All next\n`, "00010000"],
  ["a type that nobody describes", "demo/Gone data\n", "00010000 00"],
  ["a type with a name of JavaScript's", "constructor data\n", "00010000 00"],
  ["a sequence of such a type", "toString[] data\n", "00010000 01000000 00"],
  ["a message of millions of values", `demo/Part[] parts\n${LINE}MSG: demo/Part\nuint8 x\n`, `00010000 20a10700 ${"00".repeat(500_000)}`],
  ["a line that is not a field", "<b>x</b> data\n", "00010000 00"],
  ["a definition without end", "x".repeat(300_000), "00010000 00"],
  ["another encoding", "uint8 data\n", "00000000 00"],
]) {
  test(`${what} is refused, and costs nothing`, () => {
    assert.throws(() => decoderOf("demo/msg/All", definition)(bytes(hex)), CdrError);
  });
}

test("a field may have any name", () => {
  const message = decoderOf("a/msg/B", "uint8 constructor\nuint8 hasOwnProperty\n")(bytes("00010000 0102"));
  assert.deepEqual([message.constructor, message.hasOwnProperty], [1, 2]);
});
