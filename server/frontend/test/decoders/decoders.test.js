import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { DecoderChoice, FrameDecoder, afterFailure } from "../../src/decoders/frameDecoder.js";
import { jpegBlob, jpegSize } from "../../src/decoders/jpeg.js";
import { formatOf } from "../../src/decoders/keyFrames.js";
import { FakeVideoDecoder, H264_KEY, HUGE_KEY, JPEG, bytes, settle } from "../fakes.js";

// As libx264 and libvpx begin their key frames.
const HIGH = "000000016764001facb200a00b7420000003002000000791e3064900000001";
const INTERLACED = "00000001674d4015f202821f9610000003001000000303c9f142a48000000001";
const VP8 = "5047009d012a8002e00102c7";

for (const [name, codec, data, expected] of [
  ["baseline", "h264", H264_KEY, ["avc1.42C01E", 640, 480]],
  ["with scaling lists", "h264", bytes(HIGH), ["avc1.64001F", 1280, 720]],
  ["of fields", "h264", bytes(INTERLACED), ["avc1.4D4015", 320, 256]],
  ["after another unit", "h264", bytes(`0000000109f0${HIGH}`), ["avc1.64001F", 1280, 720]],
  ["VP8", "vp8", bytes(VP8), ["vp8", 640, 480]],
  ["a delta", "h264", bytes("0000000141e0"), null],
  ["cut off", "h264", bytes("000000016742c0"), null],
  ["a delta of VP8", "vp8", bytes("5147009d012a8002e00102c7"), null],
]) {
  test(`a key frame says its codec and size: ${name}`, () => {
    const format = formatOf(codec, data);
    assert.deepEqual(format && [format.codec, format.width, format.height], expected);
  });
}

const FRAME = "ffc0000b0801e00280"; // 640 x 480

for (const [name, data, expected] of [
  ["plain", JPEG, { width: 640, height: 480 }],
  ["progressive, after a table", bytes(`ffd8ffc400040000${FRAME.replace("c0", "c2")}`), { width: 640, height: 480 }],
  ["after filling, a lone marker and what is none", bytes(`ffd8ffffffd00a0bff00${FRAME}`), { width: 640, height: 480 }],
  ["without a frame", bytes(`ffd8ffda0002${FRAME}`), null],
  ["cut off", JPEG.subarray(0, -1), null],
  ["of another kind", bytes("89504e470d0a1a0a0000000d49484452"), null],
]) {
  test(`a JPEG says its size: ${name}`, () => assert.deepEqual(jpegSize(data), expected));
}

test("what would decode to gigabytes, or is not a JPEG, is refused before", () => {
  assert.equal(jpegBlob(JPEG).type, "image/jpeg");
  assert.throws(() => jpegBlob(bytes("ffd8ffc0000b084e204e20")), /20000x20000/);
  assert.throws(() => jpegBlob(bytes("89504e470d0a1a0a0000000d49484452")), /not a JPEG/);
});

test("the orientation in a JPEG turns no frame", async () => {
  const [exif, rest] = ["ffe1000845786966ab00", "ffe00004ffc0ffc0000b0801e00280"];
  const blob = jpegBlob(bytes(`ffd8${exif}${rest}`));
  assert.deepEqual(new Uint8Array(await blob.arrayBuffer()), bytes(`ffd8${rest}`));
});

const BOTH = ["h264", "vp8", "jpeg"];

for (const [name, times, working, codecs] of [
  ["once: the same codec, in software", [0], [], BOTH],
  ["again: another codec", [0, 2000], [], ["vp8", "jpeg"]],
  ["again after long: the same", [0, 60_001], [], BOTH],
  ["three times, and worked between: the same", [0, 2000, 4000], ["h264"], BOTH],
  ["a fourth time within a minute: another codec", [0, 2000, 4000, 6000], ["h264"], ["vp8", "jpeg"]],
]) {
  test(`what is asked for when a decoder failed ${name}`, () => {
    const start = { codecs: BOTH, failures: {}, working };
    assert.deepEqual(times.reduce((before, now) => afterFailure(before, "h264", now), start).codecs, codecs);
  });
}

let clock, choice, decoder, asked;

const newest = () => FakeVideoDecoder.made.at(-1);
const decode = (isKey, data = H264_KEY) => decoder.decode({ codec: "h264", isKey, data });

beforeEach(async () => {
  mock.timers.enable({ apis: ["setTimeout"] });
  mock.method(performance, "now", () => clock);
  FakeVideoDecoder.install();
  [clock, asked] = [0, []];
  choice = new DecoderChoice({ supported: Promise.resolve(BOTH) });
  await choice.ready;
  decoder = new FrameDecoder({ choice, onKeyFrame: () => asked.push("key frame"), onCodecs: () => asked.push(choice.codecs) });
});

afterEach(() => mock.reset());

function pass(ms, late = 0) {
  clock += ms + late;
  mock.timers.tick(ms);
}

test("each frame that is decoded is its own, and one that nobody waits for is closed", async () => {
  const key = decode(true);
  const stray = newest().give(7);
  assert.equal(stray.closed, true);
  const images = [newest().give()];
  const delta = decode(false, bytes("0000000141e0"));
  images.push(newest().give());
  assert.deepEqual([await key, await delta], images);
  const [first, second] = newest().chunks;
  assert.deepEqual([first.type, second.type], ["key", "delta"]);
  const { codec, optimizeForLatency, hardwareAcceleration } = newest().config;
  assert.deepEqual([codec, optimizeForLatency, hardwareAcceleration], ["avc1.42C01E", true, "no-preference"]);
});

test("a frame that depends on a key frame is refused before the first, and after a gap", async () => {
  await assert.rejects(decode(false), /key frame/);
  const key = decode(true);
  newest().give();
  await key;
  decoder.close();
  await assert.rejects(decode(false), /key frame/);
  assert.deepEqual(asked, ["key frame", "key frame"]);
  assert.deepEqual(choice.codecs, BOTH);
});

test("a frame that is too large is refused before it is decoded, and one that lied about it is closed", async () => {
  await assert.rejects(decode(true, HUGE_KEY), /4112x480/);
  assert.deepEqual([newest().chunks.length, newest().state], [0, "closed"]);
  const lying = decode(true);
  const image = newest().give(undefined, { codedWidth: 16_384 });
  await assert.rejects(lying, /16384x480/);
  assert.deepEqual([image.closed, newest().state], [true, "closed"]);
});

test("frames that do not come out lead to software, then to another codec, then to JPEG", async () => {
  const steps = [];
  for (let failure = 0; failure < 4; failure++) {
    const [codec] = choice.codecs;
    const late = decoder.decode({ codec, isKey: true, data: codec === "vp8" ? bytes(VP8) : H264_KEY });
    steps.push(newest().config.hardwareAcceleration);
    pass(1000);
    await assert.rejects(late, /nothing came out within 1000 ms/);
    assert.equal(newest().state, "closed");
  }
  assert.deepEqual(steps, ["no-preference", "prefer-software", "no-preference", "prefer-software"]);
  assert.deepEqual(asked, ["key frame", ["vp8", "jpeg"], "key frame", ["jpeg"]]);
  await assert.rejects(decode(true), /has failed/);
});

test("a page that was hidden or busy itself counts no frame as late", async () => {
  const key = decode(true);
  pass(1000, 101);
  globalThis.document = { hidden: true };
  pass(1000);
  delete globalThis.document;
  const image = newest().give();
  assert.equal(await key, image);
  assert.deepEqual(asked, []);
});

test("an error of the decoder is a failure, and one while it does nothing only opens another", async () => {
  const key = decode(true);
  newest().error(new Error("broken"));
  await assert.rejects(key, /broken/);
  assert.deepEqual([asked, choice.accelerationOf("h264")], [["key frame"], "prefer-software"]);
  const next = decode(true);
  newest().give();
  await next;
  newest().error(new Error("reclaimed"));
  await assert.rejects(decode(false), /key frame/);
  assert.deepEqual(choice.codecs, BOTH);
});

test("what is under way when the stream ends is dropped, and is no failure", async () => {
  const key = decode(true);
  decoder.close();
  await assert.rejects(key, /closed/);
  await settle();
  assert.deepEqual([newest().state, asked, choice.accelerationOf("h264")], ["closed", [], "no-preference"]);
});
