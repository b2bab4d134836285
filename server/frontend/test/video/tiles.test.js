import assert from "node:assert/strict";
import { test } from "node:test";

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

test("the map is no camera", () => {
  const { tiles } = withCamera();
  assert.deepEqual([tiles.has("/a"), tiles.has(MAP)], [true, false]);
});
