import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { FrameStream, SenderClock, readFrame } from "../../src/client/frames.js";
import { ShownFrames, oldestSeen } from "../../src/client/shownFrames.js";
import { FakeWebSocket, framed, settle } from "../fakes.js";

const AHEAD = 50_000;

let clock, sockets, frames, gaps, statuses, refusal, hold, stream;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  clock = 1000;
  sockets = FakeWebSocket.opened = [];
  [frames, statuses, gaps, refusal, hold] = [[], [], 0, null, null];
  stream = new FrameStream({
    url: async () => {
      if (refusal) throw refusal;
      return "wss://server/robots/sim1/video/frames?topic=%2Fcamera";
    },
    request: { quality_max: 70 },
    onFrame: ({ sequence, at, data }) => {
      frames.push({ sequence, at, data: [...data] });
      return hold?.promise;
    },
    onGap: () => (gaps += 1),
    onStatus: (status) => statuses.push(status),
    now: () => clock,
    wall: () => clock,
    openSocket: (url) => new FakeWebSocket(url),
  });
});

afterEach(() => {
  stream.stop();
  mock.restoreAll();
});

async function pass(ms) {
  for (let left = ms; left > 0; left -= 100) {
    clock += Math.min(left, 100);
    mock.timers.tick(Math.min(left, 100));
    await settle();
  }
}

async function goOpen() {
  stream.start();
  await settle();
  sockets[0].open();
  sockets[0].answerClockSync(AHEAD);
  return sockets[0];
}

const last = () => statuses.at(-1);
const why = () => [last().frame, last().why];

async function receive(frame, socket = sockets[0]) {
  socket.frame(frame);
  await settle();
}

test("it says what it asks for, syncs clocks, and gives two credits", async () => {
  const [request, sync, credit] = (await goOpen()).sent;
  assert.deepEqual(request, { op: "stream_request", quality_max: 70 });
  assert.equal(sync.op, "clock_sync");
  assert.deepEqual(credit, { op: "credit", frames: 2, taken: null });
});

test("a frame comes with its timestamp on this page's clock", async () => {
  await goOpen();
  await receive({ sequence: 7, timestampMs: AHEAD + 940, data: [1, 2], quality: 60 });
  assert.deepEqual(frames, [{ sequence: 7, at: 940, data: [1, 2] }]);
  assert.equal(last().frame, "live");
  assert.equal(last().quality, 60);
  assert.equal(stream.ageMs, 60);
});

test("a frame counts when it has been shown; one that cannot be shown, or of another codec, never does and stops nothing", async () => {
  const socket = await goOpen();
  await receive({ sequence: 1, timestampMs: AHEAD + 990 });
  clock += 500;
  hold = withResolvers();
  await receive({ sequence: 2, timestampMs: AHEAD + 1490 });
  assert.equal(stream.ageMs, 510);
  hold.reject(new Error("broken JPEG"));
  await receive({ sequence: 3, codec: 9, timestampMs: AHEAD + 1500 });
  assert.equal(stream.ageMs, 510);
  assert.deepEqual([frames.length, socket.said("credit").length], [2, 4]);
});

test("a frame that is shown after the stream was stopped does not count", async () => {
  await goOpen();
  hold = withResolvers();
  await receive({ sequence: 1, timestampMs: AHEAD + 990 });
  stream.stop();
  hold.resolve();
  await settle();
  assert.deepEqual([stream.ageMs, last().why], [null, "paused"]);
});

test("the next frame is asked for when this one has been shown", async () => {
  const socket = await goOpen();
  hold = withResolvers();
  socket.frame({ sequence: 7, timestampMs: AHEAD + 990 });
  await receive({ sequence: 8, timestampMs: AHEAD + 995 });
  assert.equal(socket.said("credit").length, 1);
  assert.equal(frames.length, 1);
  const first = hold;
  hold = null;
  first.resolve();
  await settle();
  assert.deepEqual(socket.said("credit").slice(1), [
    { op: "credit", frames: 1, taken: 8 },
    { op: "credit", frames: 1, taken: 8 },
  ]);
  assert.equal(frames.length, 2);
});

function withResolvers() {
  const parts = {};
  parts.promise = new Promise((resolve, reject) => Object.assign(parts, { resolve, reject }));
  return parts;
}

test("a frame before the first answered clock sync is not shown: its age is unknown", async () => {
  stream.start();
  await settle();
  sockets[0].open();
  await receive({ sequence: 1, timestampMs: AHEAD });
  assert.deepEqual(frames, []);
  assert.equal(last().frame, "none");
  assert.equal(sockets[0].said("credit").length, 2);
});

test("a frame is old after a second, whether it came late or no other came", async () => {
  await goOpen();
  await receive({ sequence: 1, timestampMs: AHEAD + 1000 });
  await pass(1000);
  assert.equal(last().frame, "live");
  await pass(100);
  assert.deepEqual(why(), ["old", "old"]);
  await receive({ sequence: 2, timestampMs: AHEAD + clock - 1500 });
  assert.equal(last().frame, "old");
  await receive({ sequence: 3, timestampMs: AHEAD + clock });
  assert.deepEqual(why(), ["live", ""]);
});

test("a first frame may be on its way, so a sender without one has 4 s before its camera sends none", async () => {
  (await goOpen()).tell({ op: "status", state: "waiting" });
  await pass(3900);
  assert.deepEqual(why(), ["none", "starting"]);
  await pass(100);
  assert.deepEqual(why(), ["none", "waiting"]);
});

test("the sender's status says why there is no frame, and unknown operations and broken texts say nothing", async () => {
  const socket = await goOpen();
  socket.tell({ op: "status", state: "down", detail: "no answer on 8080", source: "mjpeg" });
  socket.tell({ op: "new" });
  for (const data of ["{", "null"]) socket.onmessage({ data });
  assert.deepEqual([last().frame, last().why, last().detail, last().source], ["none", "down", "no answer on 8080", "mjpeg"]);
  await receive({ timestampMs: AHEAD + 1000 });
  assert.equal(frames.length, 1);
});

// Why there is no frame any more, in whose words.
for (const [name, act, why, detail = ""] of [
  ["after a cut", () => sockets[0].end(1006), "cut"],
  ["on a link that brings nothing, no clock sync either", () => pass(4600), "cut"],
  ["as the close code says", () => sockets[0].end(4503, "offline since 12:03 UTC"), "robot_offline", "offline since 12:03 UTC"],
  ["of a stream that was ended", () => stream.stop(), "paused"],
]) {
  test(`there is no frame any more ${name}, whatever the link still brings`, async () => {
    await goOpen();
    await receive({ timestampMs: AHEAD + 1000 });
    await act();
    await receive({ timestampMs: AHEAD + 1000 });
    assert.equal(frames.length, 1);
    assert.deepEqual([last().frame, last().why, last().detail, stream.ageMs, sockets[0].closed], ["none", why, detail, null, true]);
    await pass(500);
    assert.equal(sockets.length, why === "paused" ? 1 : 2);
  });
}

test("news that the robot is back brings the next attempt at once, but not a second one beside a link", async () => {
  const socket = await goOpen();
  stream.retryNow();
  await settle();
  assert.equal(sockets.length, 1);
  socket.end(4503);
  stream.retryNow();
  await settle();
  assert.equal(sockets.length, 2);
});

test("a refused ticket says why and is asked for again", async () => {
  refusal = Object.assign(new Error("no"), { status: 401 });
  stream.start();
  await settle();
  assert.equal(last().why, "login_missing");
  refusal = null;
  await pass(500);
  assert.equal(sockets.length, 1);
});

test("another request goes out on the open link and on the next ones", async () => {
  const socket = await goOpen();
  stream.ask({ fps: 5 });
  assert.deepEqual(socket.sent.at(-1), { op: "stream_request", quality_max: 70, fps: 5 });
  socket.end(1006);
  await pass(500);
  sockets[1].open();
  assert.deepEqual(sockets[1].sent[0], { op: "stream_request", quality_max: 70, fps: 5 });
});

test("key frames are asked for at most twice a second, and none that has come", async () => {
  const socket = await goOpen();
  const count = () => socket.said("key_frame").length;
  for (let i = 0; i < 3; i++) stream.requestKeyFrame();
  assert.equal(count(), 1);
  socket.answerClockSync(AHEAD);
  await pass(600);
  assert.equal(count(), 2);
  stream.requestKeyFrame();
  await receive({ codec: 2, flags: 2, timestampMs: AHEAD });
  await pass(600);
  assert.equal(count(), 2);
});

test("after a frame that was left out, and on another link, the next one does not continue those before", async () => {
  await goOpen();
  await receive({ codec: 2, flags: 2, timestampMs: AHEAD });
  const before = gaps;
  clock += 40_000; // no clock sync is known any more
  await receive({ codec: 2, timestampMs: AHEAD });
  assert.deepEqual([frames.length, gaps], [1, before + 1]);
  sockets[0].end(1006);
  assert.equal(gaps, before + 2);
});

test("a frame is taken out with its codec, flags, sequence, quality and timestamp, without a copy, and of another codec or cut short there is none", () => {
  const message = framed({ codec: 2, sequence: 4_000_000_000, quality: 70, flags: 3, timestampMs: 5123456.75, data: [1, 2, 3] });
  const { data, ...frame } = readFrame(message);
  const header = { sequence: 4_000_000_000, quality: 70, timestampMs: 5123456.75 };
  assert.deepEqual(frame, { ...header, codec: "h264", isKey: true });
  assert.deepEqual([...data], [1, 2, 3]);
  assert.equal(data.buffer, message);
  const messages = [framed({ codec: 9 }), framed({ timestampMs: NaN }), framed({ data: [] }), new ArrayBuffer(3)];
  assert.deepEqual(messages.map(readFrame), [null, null, null, null]);
});

let wall, senderClock;

beforeEach(() => {
  wall = 1_000_000;
  senderClock = new SenderClock({ now: () => clock, wall: () => wall });
});

function age(ms) {
  clock += ms;
  wall += ms;
}

const answer = (t_ms, sender_ms) => senderClock.receive({ t_ms, sender_ms });
const twice = () => [answer(1000, 2000), age(20_000), answer(21_000, 22_050)];
const sleep = () => [answer(1000, 5000), (wall += 3000)]; // the sender's clock went on, and this page's did not

// By the answers to clock syncs: what a timestamp of the sender's is on this page's clock.
for (const [name, act, sender, timestamp] of [
  ["nothing is known before the first answer", () => {}, 5000, null],
  ["nor by one without numbers", () => [answer("1", 5000), answer(1000)], 5000, null],
  ["the least difference counts: no age is understated", () => [answer(900, 4980), answer(950, 4960), answer(980, 5280)], 4990, 980],
  ["no timestamp is to come", () => answer(900, 900), 9999, 1000],
  ["the newest of two", twice, 22_000, 21_000],
  ["an answer counts for 30 s, in which clocks may drift apart", () => [twice(), age(10_001)], 22_000, 20_950],
  ["then none does", () => [twice(), age(30_001)], 22_000, null],
  ["after a sleep, in which this clock stood, nothing is known", sleep, 5000, null],
  ["until the next answer", () => [sleep(), answer(1000, 8000)], 5000, -2000],
]) {
  test(`the sender's clock: ${name}`, () => {
    act();
    assert.equal(senderClock.timestamp(sender), timestamp);
  });
}

function shown(...times) {
  const frames = new ShownFrames();
  times.forEach((shownAt, sequence) => frames.note({ sequence, at: shownAt - 100, shownAt }));
  return frames;
}

test("a frame is seen from when it is shown until the next one is", () => {
  const frames = shown(1000, 1100, 1200);
  assert.equal([1000, 1099, 1100, 1500].map((timestamp) => frames.seenAt(timestamp).sequence).join(), "0,0,1,2");
});

test("a frame is not seen before the display has it, and not at all if it was forgotten before", () => {
  const pictures = [];
  let clock = 1000;
  globalThis.requestAnimationFrame = (act) => pictures.push(act);
  const display = (ms) => ((clock += ms), pictures.splice(0).forEach((act) => act()));
  const frames = new ShownFrames({ now: () => clock });
  frames.draw({ sequence: 1, at: 900 });
  display(7);
  assert.equal(frames.seenAt(clock), null);
  frames.draw({ sequence: 2, at: 960 });
  display(17);
  assert.equal(frames.seenAt(1023), null);
  assert.deepEqual(frames.seenAt(1024), { sequence: 1, at: 900, shownAt: 1024 });
  globalThis.document = /** @type {any} */ ({ hidden: true });
  frames.draw({ sequence: 3, at: 1000 });
  assert.deepEqual([pictures.length, frames.seenAt(clock).sequence], [1, 1]);
  delete globalThis.document;
  frames.forget();
  display(17);
  assert.equal(frames.seenAt(clock), null);
});

test("what is kept is bounded, and can be forgotten", () => {
  const frames = shown(...Array.from({ length: 1000 }, (_, place) => place * 10));
  assert.ok(frames.frames.length <= 202);
  frames.forget();
  assert.equal(frames.seenAt(1e6), null);
});

test("of more views than a command can name, the oldest are named, and first what may be older still", () => {
  const views = Array.from({ length: 10 }, (_, place) => ({ topic: `/camera${place}`, frames: new ShownFrames() }));
  views.forEach(({ frames }, place) => place && frames.note({ sequence: place, at: 1000 - place, shownAt: 1000 }));
  views[5].frames.note({ sequence: 50, at: null, shownAt: 1001 });
  const named = oldestSeen(views, 1001).map(({ frame }) => frame);
  assert.deepEqual(named, [null, 50, 9, 8, 7, 6, 4, 3]);
});
