import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { Video, streamUrl } from "../src/video.js";

let clock, answers, frames, status, video;

// A stream that the test feeds, and the answer that carries it.
function openStream() {
  let feed;
  const body = new ReadableStream({ start: (controller) => (feed = controller) });
  const headers = { "Content-Type": "multipart/x-mixed-replace;boundary=b" };
  return { feed, answer: new Response(body, { headers }) };
}

const jpeg = (text) => new TextEncoder().encode(`--b\r\nContent-Length: ${text.length}\r\n\r\n${text}\r\n`);

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  clock = 0;
  answers = [];
  frames = [];
  mock.method(globalThis, "fetch", async () => {
    const answer = answers.shift();
    if (!answer) throw new TypeError("no network");
    return answer;
  });
  video = new Video({
    onFrame: (frame) => frames.push(new TextDecoder().decode(frame)),
    onStatus: (value) => (status = value),
    now: () => clock,
  });
});

afterEach(() => {
  video.pause();
  mock.restoreAll();
});

// The streams of the platform hand data on by real tasks, which no mocked timer moves.
async function settle() {
  for (let i = 0; i < 5; i++) await new Promise((resolve) => setImmediate(resolve));
}

async function pass(ms) {
  clock += ms;
  mock.timers.tick(ms);
  await settle();
}

test("the address is web_video_server's, with a size only when one is set", () => {
  assert.equal(
    streamUrl("sim 1", { topic: "/camera/image_raw", quality: "70" }),
    "/robots/sim%201/video/stream?topic=%2Fcamera%2Fimage_raw&type=mjpeg&quality=70",
  );
  assert.match(streamUrl("a", { topic: "/c", quality: "70", width: 320, height: 240 }), /width=320&height=240$/);
});

test("frames are shown as they come", async () => {
  const { feed, answer } = openStream();
  answers.push(answer);
  video.play("/stream");
  feed.enqueue(jpeg("one"));
  await settle();
  feed.enqueue(jpeg("two"));
  await settle();
  assert.deepEqual(frames, ["one", "two"]);
  assert.equal(status.picture, "live");
});

test("a cut stream is started again", async () => {
  const first = openStream();
  const second = openStream();
  answers.push(first.answer, second.answer);
  video.play("/stream");
  first.feed.close();
  await settle();
  assert.equal(status.picture, "none");
  second.feed.enqueue(jpeg("again"));
  await pass(500);
  assert.deepEqual(frames, ["again"]);
});

test("the server's code becomes a sentence", async () => {
  answers.push(Response.json({ code: "video_down" }, { status: 502 }));
  video.play("/stream");
  await settle();
  assert.match(status.text, /video server does not answer/);
});

test("an answer that is no stream is told, not shown", async () => {
  answers.push(new Response("<h1>hello</h1>", { headers: { "Content-Type": "text/html" } }));
  video.play("/stream");
  await settle();
  assert.equal(status.picture, "none");
  assert.deepEqual(frames, []);
});

test("a stream that stalls is old after two seconds and started again after six", async () => {
  const { feed, answer } = openStream();
  answers.push(answer);
  video.play("/stream");
  feed.enqueue(jpeg("one"));
  await settle();
  for (let i = 0; i < 3; i++) await pass(1000);
  assert.deepEqual(status, { picture: "old", text: "The picture is 3 s old." });
  for (let i = 0; i < 4; i++) await pass(1000);
  assert.equal(status.picture, "none");
  await pass(500);
  assert.equal(fetch.mock.callCount(), 2);
});

test("a paused video asks for nothing", async () => {
  video.play("/stream");
  await settle();
  video.pause();
  const asked = fetch.mock.callCount();
  video.retryNow();
  await pass(60_000);
  assert.equal(fetch.mock.callCount(), asked);
});
