import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { ShownFrames } from "../../src/client/shownFrames.js";
import { MAP } from "../../src/video/layout.js";
import { Tiles } from "../../src/video/tiles.js";

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
