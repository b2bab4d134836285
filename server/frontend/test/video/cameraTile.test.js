import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { CameraTile, FrameRate, requestedQuality, requestedSize } from "../../src/video/cameraTile.js";
import { part } from "../../src/dom/page.js";
import { frame } from "../../src/texts/video.js";
import { FakeElement } from "../fakes.js";

let clock, streams, element, tile, choice, paintings, downs;

const textOf = (name) => part(element, name).textContent;

// A stream that does what the test says, in place of client/frames.js.
function openFrames(topic, options) {
  const stream = { topic, ...options, asked: [options.request], started: false };
  stream.start = () => (stream.started = true);
  stream.stop = () => (stream.started = false);
  stream.ask = (request) => stream.asked.push(request);
  streams.push(stream);
  return stream;
}

// Frames are decoded when the test says so, each to its size.
const decoder = () => ({ decode: () => new Promise((done, failed) => paintings.push({ done, failed })), close() {} });

beforeEach(() => {
  globalThis.requestAnimationFrame = (act) => act();
  clock = 1000;
  streams = [];
  paintings = [];
  downs = [];
  element = Object.assign(new FakeElement(), { dataset: { main: "true" }, clientWidth: 800, clientHeight: 600 });
  choice = { codecs: ["h264", "jpeg"], ready: Promise.resolve() };
  tile = new CameraTile(element, {
    camera: { topic: "/front", name: "front" },
    openFrames,
    common: () => ({ fps: 15 }),
    set: { width: null, height: null },
    oldMs: 1000,
    onPainted: () => {},
    onDown: (topic) => downs.push(topic),
    now: () => clock,
    choice,
    painter: { turned: 0, show: (size) => size },
    decoder: decoder(),
  });
  tile.start();
});

test("a frame counts and is seen from when it stands on the page, until the machine sleeps", async () => {
  const shown = streams[0].onFrame({ codec: "h264", at: 900, sequence: 41 });
  assert.deepEqual([tile.shownFrames.seenAt(clock), tile.at, tile.state], [null, null, "none"]);
  clock = 1020;
  paintings[0].done({ width: 640, height: 480 });
  await shown;
  assert.deepEqual([tile.shownFrames.seenAt(1019), tile.at, tile.state, element.dataset.frame], [null, 900, "live", "live"]);
  assert.deepEqual(tile.shownFrames.seenAt(1020), { sequence: 41, at: 900, shownAt: 1020 });
  tile.forget();
  assert.deepEqual([tile.shownFrames.seenAt(1020), tile.state], [null, "none"]);
  await paint(990);
  assert.equal(tile.state, "live");
});

async function paint(at, size = { width: 640, height: 480 }) {
  const shown = streams.at(-1).onFrame({ codec: "h264", at });
  paintings.at(-1).done(size);
  await shown;
}

test("a frame that cannot be decoded is none", async () => {
  const shown = streams[0].onFrame({ codec: "h264", at: 900 });
  paintings[0].failed(new Error("broken"));
  await assert.rejects(shown);
  assert.equal(tile.at, null);
});

test("an old frame stays with words, and with its age where the page has none for it", async () => {
  await paint(900);
  streams[0].onStatus({ frame: "none", why: "link_lost", detail: "" });
  clock = 13_900;
  tile.showState();
  assert.equal(element.dataset.frame, "old");
  assert.match(textOf("words"), /^This video is old. The link to the robot was lost/);
  assert.doesNotMatch(textOf("facts"), /13 s/);
  element.dataset.main = "false";
  tile.showState();
  assert.equal(textOf("facts"), "13 s old");
});

test("the reason that the server or the robot gave is never replaced", () => {
  for (const why of ["down", "robot_offline", "video_down", "rights_ended", "crowded", "slow", "restarting", "link_lost", "refused"])
    assert.match(frame.why[why]("you read nothing for 10 s"), /^You read nothing for 10 s\./, why);
});

test("a frame that is decoded after the stream has ended counts no more", async () => {
  const shown = streams[0].onFrame({ codec: "h264", at: 900 });
  tile.stop();
  tile.start();
  const image = { close: () => (image.closed = true) };
  paintings[0].done(image);
  await shown;
  assert.deepEqual([tile.at, image.closed], [null, true]);
  assert.deepEqual([streams[0].started, streams[1].started], [false, true]);
});

test("a small tile asks for less as soon as the camera's size is known, once, and for what the browser decodes", async () => {
  Object.assign(element, { clientWidth: 300, clientHeight: 225 });
  await paint(900);
  await paint(950, { width: 320, height: 240 });
  tile.ask();
  assert.deepEqual(streams[0].asked.slice(1), [{ fps: 15, codecs: ["h264", "jpeg"], width: 320, height: 240 }]);
  choice.codecs = ["jpeg"];
  tile.ask();
  assert.deepEqual(streams[0].asked.at(-1).codecs, ["jpeg"]);
});

for (const [name, codec, codecs, status, note] of [
  ["the encoder", "h264", ["h264", "jpeg"], { encoder: "libx264", no_encoder: "" }, "H.264, encoded by libx264"],
  ["a camera's own", "h264", ["h264", "jpeg"], { encoder: null, no_encoder: "" }, "H.264"],
  ["why there is none", "jpeg", ["h264", "jpeg"], { no_encoder: "PyAV is not installed" }, "JPEG: PyAV is not installed."],
  ["what the browser lacks", "jpeg", ["jpeg"], { no_encoder: "" }, "JPEG: this browser decodes nothing else here."],
]) {
  test(`how frames are encoded is known of those that are shown: ${name}`, async () => {
    choice.codecs = codecs;
    streams[0].onStatus({ frame: "live", why: "", ...status });
    assert.equal(tile.encoding, "");
    const shown = streams[0].onFrame({ codec, at: 900 });
    paintings[0].done({ width: 640, height: 480 });
    await shown;
    assert.equal(tile.encoding, note);
    assert.match(textOf("facts"), new RegExp(`^${codec === "h264" ? "H.264" : "JPEG"} · .*640×480$`));
  });
}

test("before the first frame the reason is written in words", async () => {
  streams[0].onStatus({ frame: "none", why: "down", detail: "no such topic" });
  assert.equal(textOf("words"), "No such topic.");
  streams[0].onStatus({ frame: "none", why: "down", detail: "web_video_server at http://h:1 does not answer" });
  assert.equal(textOf("words"), "web_video_server at http://h:1 does not answer.");
  assert.deepEqual(downs, ["/front", "/front"]);
  streams[0].onStatus({ frame: "none", why: "a word of a newer client", detail: "" });
  assert.equal(textOf("words"), "The camera sends no video.");
});

test("the rate is that of the last two seconds and falls when nothing comes; one frame has none", () => {
  const rate = new FrameRate();
  rate.hit(-10);
  assert.equal(rate.perSecond(0), null);
  for (let at = 0; at <= 3000; at += 100) rate.hit(at);
  assert.equal(rate.perSecond(3000), 10);
  assert.equal(rate.perSecond(4000), 5);
  assert.equal(rate.perSecond(9000), 0);
});

const none = { width: null, height: null };
const SET = { width: 800, height: 600 };

// The size that is asked for, by the place on the page and what differs from a camera of 640 x 480 without a size in the settings.
for (const [what, width, height, more, expected] of [
  ["a large place wants the camera's own", 900, 700, {}, none],
  ["so does one not much smaller", 500, 375, {}, none],
  ["a small one wants a half", 320, 240, {}, { width: 320, height: 240 }],
  ["a few pixels more change nothing", 345, 260, {}, { width: 320, height: 240 }],
  ["a smaller one wants a quarter", 170, 130, {}, { width: 160, height: 120 }],
  ["one on its side is as wide as the place is high", 170, 320, { turned: 90 }, { width: 320, height: 240 }],
  ["before the camera's size is known its own is wanted", 100, 80, { full: null }, none],
  ["before the place is known, too", 0, 0, {}, none],
  ["the settings' size stands for the camera's own", 900, 700, { set: SET }, SET],
  ["of that a half is wanted, too", 400, 300, { set: SET, full: null }, { width: 400, height: 300 }],
]) {
  test(`size: ${what}`, () => {
    const size = { full: { width: 640, height: 480 }, set: none, box: { width, height }, turned: 0, ...more };
    assert.deepEqual(requestedSize(size), expected);
  });
}

test("automatic is the settings' range, and a step is that alone", () => {
  assert.deepEqual(requestedQuality("auto", { quality_min: 30, quality_max: 60 }), { quality_min: 30, quality_max: 60 });
  assert.deepEqual(requestedQuality("sharp", { quality_min: 30 }), { quality_min: 30, quality_max: 80, prefers: "sharp" });
  assert.deepEqual(requestedQuality("50", {}), { quality_min: 50, quality_max: 50 });
  assert.deepEqual(requestedQuality("nonsense"), { quality_min: 20, quality_max: 80 });
});
