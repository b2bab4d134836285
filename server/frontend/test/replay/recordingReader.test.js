import assert from "node:assert/strict";
import { test } from "node:test";

import { McapWriter } from "@mcap/core";

import { CdrError, decoderOf } from "../../src/replay/cdr.js";
import { BrokenFileError, RangeFile, RangeFileError } from "../../src/replay/rangeFile.js";
import { RecordingReader } from "../../src/replay/recordingReader.js";

const BEGAN_NS = 1_700_000_000_000_000_000n;
const ns = (ms) => BEGAN_NS + BigInt(Math.round(ms * 1e6));

const encoder = new TextEncoder();

// A std_msgs/String in CDR.
function text(words) {
  const data = encoder.encode(`${words}\0`);
  const message = new Uint8Array(8 + data.length);
  message.set([0, 1, 0, 0]);
  new DataView(message.buffer).setUint32(4, data.length, true);
  message.set(data, 8);
  return message;
}

class Memory {
  parts = [];
  size = 0;
  position = () => BigInt(this.size);
  async write(bytes) {
    this.parts.push(bytes.slice());
    this.size += bytes.length;
  }
}

// `messages` are {topic, atMs, data, logNs}, each in a chunk of its own. Gives the file's bytes, and where each message's chunk ends.
async function recordingOf(messages, { definition = "string data\n" } = {}) {
  const file = new Memory();
  const writer = new McapWriter({ writable: file, chunkSize: 1 });
  await writer.start({ profile: "ros2", library: "robotether" });
  const schemaId = await writer.registerSchema({ name: "std_msgs/msg/String", encoding: "ros2msg", data: encoder.encode(definition) });
  const channels = new Map();
  for (const topic of new Set(messages.map((message) => message.topic))) {
    channels.set(topic, await writer.registerChannel({ schemaId, topic, messageEncoding: "cdr", metadata: new Map() }));
  }
  const ends = [];
  for (const { topic, atMs, data = text(String(atMs)), logNs = ns(atMs) } of messages) {
    await writer.addMessage({ channelId: channels.get(topic), sequence: 0, logTime: logNs, publishTime: logNs, data });
    ends.push(file.size);
  }
  await writer.end();
  return { bytes: Buffer.concat(file.parts), ends };
}

// As nginx sends a file; `asked` has the size of each piece. `answers` come before that.
function serverOf(bytes, { answers = [] } = {}) {
  const asked = [];
  async function load(_url, { headers }) {
    const early = answers.shift();
    if (early) return early;
    const [first, last] = headers.Range.match(/\d+/g).map(Number);
    const piece = bytes.subarray(first, last + 1);
    asked.push(piece.length);
    return new Response(piece, { status: 206, headers: { "Content-Range": `bytes ${first}-${first + piece.length - 1}/${bytes.length}` } });
  }
  return { load, asked };
}

const at = (atMs, topic = "/a") => ({ topic, atMs });
const MESSAGES = [at(0), at(500, "/b"), at(1000), at(5000), at(5500, "/b")];
const TOPICS = ["/a", "/b"];

async function opened(bytes, options) {
  const server = serverOf(bytes, options);
  const file = await new RangeFile("/file", { load: server.load, wait: async () => {} }).open();
  return { reader: await RecordingReader.open(file), asked: server.asked };
}

async function times(messages) {
  const list = [];
  for await (const { atMs } of messages) list.push(atMs);
  return list;
}

test("messages come by their times, also backwards, and a gap is a gap", async () => {
  const { reader } = await opened((await recordingOf(MESSAGES)).bytes);
  assert.deepEqual(await times(reader.messages({ topics: TOPICS })), [0, 500, 1000, 5000, 5500]);
  assert.deepEqual(await times(reader.messages({ topics: TOPICS, afterMs: 500, toMs: 5000 })), [1000, 5000]);
  assert.deepEqual(await times(reader.backwards({ topics: ["/a"], toMs: 4999 })), [1000, 0]);
  assert.deepEqual(reader.spans(), [
    { fromMs: 0, toMs: 1000 },
    { fromMs: 5000, toMs: 5500 },
  ]);
  assert.deepEqual(reader.spans(["/b"]).length, 2);
  assert.deepEqual([reader.durationMs, reader.isWhole], [5500, true]);
});

test("a large file is never loaded as a whole", async () => {
  const data = text("x".repeat(100_000));
  const messages = Array.from({ length: 100 }, (_, i) => ({ ...at(i * 500), data }));
  const { bytes } = await recordingOf(messages);
  const { reader, asked } = await opened(bytes);
  assert.deepEqual(await times(reader.messages({ topics: TOPICS, afterMs: 20_000, toMs: 22_000 })), [20_500, 21_000, 21_500, 22_000]);
  const loaded = asked.reduce((sum, size) => sum + size, 0);
  assert.ok(loaded < bytes.length / 3, `${loaded} of ${bytes.length}`);
});

test("a file that is cut anywhere plays as far as it is whole", async () => {
  const { bytes, ends } = await recordingOf(MESSAGES);
  for (let size = ends[0]; size < bytes.length; size += 31) {
    const { reader } = await opened(bytes.subarray(0, size));
    const whole = ends.filter((end) => end <= size).length;
    const read = await times(reader.messages({ topics: TOPICS }));
    assert.deepEqual(read, [0, 500, 1000, 5000, 5500].slice(0, whole));
    assert.equal(reader.isWhole, false);
  }
});

test("what is damaged is left out, and said", async () => {
  const { bytes, ends } = await recordingOf(MESSAGES);
  const damaged = Buffer.from(bytes);
  damaged[ends[1] + 80] ^= 255; // in the third chunk
  const { reader } = await opened(damaged);
  const read = await times(reader.messages({ topics: TOPICS }));
  for (const whole of [0, 500, 5000, 5500]) assert.ok(read.includes(whole));
  assert.ok(reader.damages > 0);
});

test("a file that lies about where its parts are is refused, and costs nothing", async () => {
  const { bytes } = await recordingOf(MESSAGES);
  const footer = bytes.length - 8 - 20;
  for (const start of [1n, 2n ** 62n, BigInt(bytes.length)]) {
    const lying = Buffer.from(bytes);
    lying.writeBigUInt64LE(start, footer);
    await assert.rejects(opened(lying));
  }
  const file = await new RangeFile("/file", serverOf(bytes)).open();
  await assert.rejects(file.read(0n, 2n ** 40n), BrokenFileError);
});

test("enormous times are none of a recording", async () => {
  const messages = [at(0), { topic: "/a", logNs: 2n ** 64n - 1n }, at(500), { topic: "/a", logNs: 1n }, at(1000)];
  const { reader } = await opened((await recordingOf(messages)).bytes);
  assert.deepEqual([reader.durationMs, reader.left], [1000, 2]);
  assert.deepEqual(await times(reader.messages({ topics: TOPICS })), [0, 500, 1000]);
});

test("messages of a definition that is none are counted and left out", async () => {
  const { bytes } = await recordingOf([at(0)], { definition: "<b>x</b> data\n" });
  const { reader } = await opened(bytes);
  for await (const message of reader.messages({ topics: TOPICS })) assert.equal(reader.decode(message), null);
  assert.equal(reader.unreadable, 1);
});

test("a busy server is asked again, and one that refuses says why", async () => {
  const { bytes } = await recordingOf([at(0)]);
  const busy = new Response(null, { status: 429 });
  assert.equal((await opened(bytes, { answers: [busy] })).reader.durationMs, 0);
  const refusal = new Response('{"detail":"cannot send the recording: its file is gone"}', {
    status: 404,
    headers: { "Content-Type": "application/problem+json" },
  });
  const isRefused = (error) => error instanceof RangeFileError && error.status === 404 && error.detail.includes("gone");
  await assert.rejects(opened(bytes, { answers: [refusal] }), isRefused);
  const whole = new Response(bytes, { status: 200 });
  await assert.rejects(opened(bytes, { answers: [whole] }), RangeFileError);
});

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
  ["a message of too many values", "bool[] data\n", `00010000 21a10700 ${"00".repeat(500_001)}`],
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
