import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { Robot } from "../../src/client/index.js";
import { DecoderChoice } from "../../src/decoders/frameDecoder.js";
import { settle } from "../fakes.js";
import { FakeVideoDecoder, H264_KEY, JPEG } from "../decoders/fakes.js";
import { FakeWebSocket } from "./fakes.js";

let sockets;

beforeEach(() => {
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  sockets = FakeWebSocket.opened = [];
  const requestAnimationFrame = (act) => act();
  Object.assign(globalThis, { location: { origin: "https://lab.example" }, WebSocket: FakeWebSocket, requestAnimationFrame });
});

afterEach(() => {
  mock.reset();
  delete globalThis.VideoDecoder;
});

const make = () => new Robot({ server: "https://robots.example", robot: "sim 1", getTicket: async () => "t1" });

test("a canvas gets H.264 where the browser decodes it, with key frames on request, and an <img> JPEG", async () => {
  FakeVideoDecoder.install();
  const context = { setTransform() {}, rotate() {}, drawImage() {} };
  const canvas = { localName: "canvas", width: 0, height: 0, getContext: () => context };
  for (const element of [canvas, { localName: "img" }]) {
    const robot = make();
    robot.decoderChoice = new DecoderChoice({ supported: Promise.resolve(["h264", "jpeg"]) });
    const stream = robot.showVideo(element, { topic: "/front" });
    await settle();
    sockets.at(-1).open();
    sockets.at(-1).answerClockSync(0);
    assert.deepEqual(sockets.at(-1).sent[0].codecs, element === canvas ? ["h264", "jpeg"] : undefined);
    if (element === canvas) await showH264(stream, sockets.at(-1));
    stream.stop();
  }
});

async function showH264(stream, socket) {
  const timestampMs = performance.now();
  socket.frame({ codec: 2, timestampMs });
  await settle();
  assert.equal(socket.said("key_frame").length, 1);
  socket.frame({ codec: 2, flags: 2, timestampMs, data: [...H264_KEY] });
  await settle();
  const [decoder] = FakeVideoDecoder.made;
  assert.equal(stream.ageMs, null);
  const image = decoder.give();
  await settle();
  assert.ok(stream.ageMs >= 0);
  assert.equal(image.closed, true);
  stream.stop();
  assert.equal(decoder.state, "closed");
}

test("commands name the frames of the cameras that are shown, else of the last ones, none before the first and nothing without video", async () => {
  class Image {
    localName = "img";
    set src(_) {
      this.onload();
    }
  }
  const robot = make();
  const seen = () => robot.session.stamp(performance.now())?.seen;
  assert.equal(seen(), undefined);
  const streams = [];
  const [front, rear] = [41, 7].map((frame) => ({ camera: `/${frame}`, frame }));
  for (const { camera: topic, frame: sequence } of [front, rear]) {
    streams.push(robot.showVideo(new Image(), { topic }));
    if (topic === front.camera) assert.deepEqual(seen(), []);
    await settle();
    sockets.at(-1).open();
    sockets.at(-1).answerClockSync(0);
    sockets.at(-1).frame({ sequence, timestampMs: performance.now(), data: [...JPEG] });
    await settle();
  }
  assert.deepEqual(seen(), [front, rear]);
  streams[0].stop();
  assert.deepEqual(seen(), [rear]);
  streams[1].stop();
  assert.deepEqual(seen(), [rear]);
  assert.throws(() => robot.showVideo({ localName: "p" }), /cannot show video in <p>/);
});
