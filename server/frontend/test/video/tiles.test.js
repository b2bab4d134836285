import assert from "node:assert/strict";
import { beforeEach, describe, test } from "node:test";

import { Painter } from "../../src/client/painter.js";
import { ShownFrames } from "../../src/client/shownFrames.js";
import { KeyFrameMissingError } from "../../src/decoders/streamDecoder.js";
import { part } from "../../src/dom/page.js";
import { frame } from "../../src/texts/video.js";
import { CameraTile, FrameRate, requestedQuality, requestedSize } from "../../src/video/cameraTile.js";
import { Layout, MAP } from "../../src/video/layout.js";
import { Tiles } from "../../src/video/tiles.js";
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

test("a frame that cannot be decoded is none, and its camera is not said to send none", async () => {
  streams[0].onStatus({ frame: "none", why: "waiting", detail: "" });
  for (const [error, words] of /** @type {[Error, RegExp][]} */ ([
    [new KeyFrameMissingError(), /sends no video/],
    [new Error("broken"), /cannot be decoded/],
  ])) {
    const shown = streams[0].onFrame({ codec: "h264", at: 900 });
    paintings.at(-1).failed(error);
    await assert.rejects(shown);
    tile.showState();
    assert.equal(tile.at, null);
    assert.match(textOf("words"), words);
  }
  streams[0].onStatus({ frame: "none", why: "robot_offline", detail: "" });
  assert.match(textOf("words"), /offline/);
});

test("a frame counts for nothing that a lost canvas does not show", async () => {
  let lost = true;
  let closed = 0;
  const context = { isContextLost: () => lost, setTransform() {}, rotate() {}, drawImage() {} };
  tile.painter = new Painter({ getContext: () => context });
  const image = { width: 640, height: 480, close: () => (closed += 1) };
  await assert.rejects(paint(900, image), /lost the canvas/);
  assert.deepEqual([tile.at, tile.state, closed], [null, "none", 1]);
  lost = false;
  await paint(950, image);
  assert.equal(tile.state, "live");
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

for (const [name, codec, codecs, status, note] of [
  ["the encoder", "h264", ["h264", "jpeg"], { encoder: "libx264", no_encoder: "" }, "H.264, encoded by libx264"],
  [
    "why it makes few",
    "h264",
    ["h264", "jpeg"],
    { encoder: "libx264", no_encoder: "the robot's processor is slow" },
    "H.264, encoded by libx264: The robot's processor is slow.",
  ],
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
  ["no side is longer than a request may have", 6000, 500, { full: { width: 12000, height: 1000 } }, { width: 4096, height: 500 }],
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

describe("layouts", () => {
  const ALL = ["/a", "/b", "/c"];

  let layout;

  beforeEach(() => {
    layout = new Layout();
    layout.offer(ALL);
  });

  const choose = (id) => layout.choose(id);
  const offer = (...ids) => layout.offer(ids);

  // What is shown, the main one first, or in a grid in its place.
  for (const [name, act, shown] of [
    ["one frame is shown until more are wanted", () => {}, ["/a"]],
    ["what is not a layout changes nothing", () => [layout.use("inset"), layout.use("nonsense")], ["/a", "/b"]],
    ["beside a map that is chosen the camera before goes on", () => [offer(...ALL, MAP), choose("/b"), choose(MAP)], [MAP, "/b"]],
    ["a camera that is chosen after it is alone again", () => [offer(...ALL, MAP), choose("/b"), choose(MAP), choose("/a")], ["/a"]],
    ["a map without any camera stands alone", () => offer(MAP), [MAP]],
    ["swapping makes the main one the inset", () => [layout.use("inset"), choose("/b")], ["/b", "/a"]],
    ["the next camera goes round", () => [layout.next(), layout.next(), layout.next()], ["/a"]],
    ["a number names one, and one too high none", () => [layout.nth(2), layout.nth(3)], ["/c"]],
    ["a grid has four places", () => [layout.use("grid"), offer(...ALL, "/d", "/e"), choose("/c")], ["/a", "/b", "/c", "/d"]],
    ["a fifth takes the last place of it", () => [layout.use("grid"), offer(...ALL, "/d", "/e"), choose("/e")], ["/a", "/b", "/c", "/e"]],
    ["while a chosen camera is away there is another", () => [choose("/c"), offer("/a", "/b")], ["/a"]],
    ["a chosen camera comes back into its place", () => [choose("/c"), offer("/a", "/b"), offer(...ALL)], ["/c"]],
    ["no source shows nothing", () => [offer(), layout.next()], []],
  ]) {
    test(name, () => {
      act();
      assert.deepEqual(layout.shown, shown);
    });
  }

  test("what has shown a frame stays the main one until another is chosen, whatever comes later", () => {
    layout = new Layout({ main: "/c" });
    const mains = [() => [offer("/b"), layout.keep("/b"), offer(...ALL)], () => layout.keep("/a"), () => choose("/c")].map((act) => {
      act();
      return layout.main;
    });
    assert.deepEqual(mains, ["/b", "/b", "/c"]);
  });

  test("what was chosen is remembered, and nonsense in the memory is left out", () => {
    layout.use("inset");
    choose("/c");
    layout.turn("/c");
    layout = new Layout(JSON.parse(JSON.stringify(layout.memory)));
    offer(...ALL);
    assert.deepEqual([layout.shown, layout.turned("/c")], [["/c", "/a"], 90]);
    layout = new Layout({ kind: 7, main: {}, turns: { "/a": 45 } });
    offer("/a");
    assert.deepEqual([layout.shown, layout.turned("/a")], [["/a"], 0]);
  });
});

describe("tiles", () => {
  // Tiles without a page, of which one camera has a place, and what became of its stream.
  function withCamera() {
    const calls = [];
    const tile = { start: () => calls.push("start"), stop: (why) => calls.push(why), turn() {}, ask() {} };
    const tiles = Object.assign(new Tiles({ dataset: {} }, {}), { place() {} });
    tiles.tiles.set("/a", tile).set(MAP, tile);
    const arrange = (playing) =>
      tiles.arrange({ kind: "one", main: "/a", shown: [{ topic: "/a" }], turned: () => 0, playing, why: "paused" });
    tiles.drop = () => {};
    return { tiles, arrange, calls };
  }

  test("a camera that is switched off stays off, whatever is arranged, until it is switched on", () => {
    const { tiles, arrange, calls } = withCamera();
    arrange(true);
    tiles.switchTo("/a", false);
    arrange(true);
    tiles.switchTo("/a", true);
    assert.deepEqual(calls, ["start", "off", "off", "start"]);
  });

  test("a camera that is switched on in the background waits for the page to be seen", () => {
    const { tiles, arrange, calls } = withCamera();
    arrange(false);
    tiles.switchTo("/a", false);
    tiles.switchTo("/a", true);
    assert.deepEqual(calls, ["paused", "off"]);
  });

  let tiles, frames;

  const tile = (shownFrames) => ({ shownFrames, forget: () => shownFrames?.forget() });

  beforeEach(() => {
    tiles = new Tiles(null, {});
    frames = { front: new ShownFrames(), rear: new ShownFrames() };
    tiles.tiles = new Map([
      ["/front", tile(frames.front)],
      [MAP, tile()],
      ["/rear", tile(frames.rear)],
    ]);
  });

  const seen = (timestamp) => tiles.seenAt(timestamp).map(({ topic, sequence }) => `${topic} ${sequence}`);

  test("a driver sees one frame of each camera that shows any; the map is none", () => {
    assert.deepEqual(seen(100), []);
    frames.front.note({ sequence: 0, at: 80, shownAt: 100 });
    assert.deepEqual(seen(100), ["/front 0"]);
    frames.rear.note({ sequence: 7, at: 80, shownAt: 110 });
    assert.deepEqual(seen(110), ["/front 0", "/rear 7"]);
  });

  test("until another camera shows a frame, what was seen last counts", () => {
    frames.front.note({ sequence: 1, at: 80, shownAt: 100 });
    seen(100);
    tiles.tiles.delete("/front");
    assert.deepEqual(seen(5000), ["/front 1"]);
    frames.rear.note({ sequence: 7, at: 4990, shownAt: 5010 });
    assert.deepEqual(seen(5010), ["/rear 7"]);
  });

  test("a camera that the driver switched off is not seen", () => {
    frames.front.note({ sequence: 1, at: 80, shownAt: 100 });
    frames.rear.note({ sequence: 7, at: 80, shownAt: 100 });
    tiles.off.add("/rear");
    assert.deepEqual(seen(100), ["/front 1"]);
    tiles.off.add("/front");
    assert.deepEqual(seen(5000), ["/front 1"]);
  });

  test("after a sleep nothing is seen until a frame comes", () => {
    frames.front.note({ sequence: 1, at: 80, shownAt: 100 });
    seen(100);
    tiles.forget();
    assert.deepEqual(seen(200), []);
  });
});
