import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { LaserRing, ringPoints } from "../../src/overlays/laserRing.js";
import { isEmpty, isLost, MapTile, multiples, wordsOf } from "../../src/overlays/mapTile.js";

let shown, tile;

beforeEach(() => {
  globalThis.requestAnimationFrame = () => 1;
  shown = [];
  const parts = { setAttribute() {}, addEventListener() {} };
  const element = { querySelector: () => parts };
  tile = (options = {}) => new MapTile(element, { world: { show: (seen) => shown.push(seen) }, ...options });
});

test("a small map that is not running takes nothing from the large one", () => {
  const [small, large] = [tile({ small: true }), tile()];
  large.start();
  assert.deepEqual(shown, [{ scan: true, path: true, map: true }]);
  small.stop();
  assert.equal(shown.length, 1);
});

test("nothing is to draw while neither the robot's place nor a wanted part is known", () => {
  const all = { scan: true, path: true, map: true };
  const nowhere = { robot: { unknown: true }, map: null, points: null };
  assert.equal(isEmpty(nowhere, all), true);
  assert.equal(isEmpty({ ...nowhere, robot: { x: 0, y: 0 } }, all), false);
  assert.equal(isEmpty({ ...nowhere, map: {} }, all), false);
  assert.equal(isEmpty({ ...nowhere, points: [1, 1] }, all), false);
  assert.equal(isEmpty({ ...nowhere, points: [1, 1] }, { ...all, scan: false }), true);
});

test("a robot is not drawn in a map in which its place is unknown", () => {
  assert.equal(isLost({ robot: { unplaced: true }, map: {} }, { map: true }), true);
  assert.equal(isLost({ robot: { unknown: true }, map: {} }, { map: true }), true);
  assert.equal(isLost({ robot: { unplaced: true }, map: {} }, { map: false }), false);
  assert.equal(isLost({ robot: { x: 1, y: 0 }, map: {} }, { map: true }), false);
});

test("the grid of a robot at a place without sense has few lines, and an end", () => {
  assert.deepEqual(multiples(5, -6, 11), [-5, 0, 5, 10]);
  for (const place of [1e17, -1e300, Number.MAX_VALUE, Infinity, NaN]) {
    const lines = multiples(1, place - 10, place + 10);
    assert.ok(lines.length <= 100, `${place}`);
  }
});

test("a map that cannot be read is said to whoever wants to see the map", () => {
  const world = { robot: { x: 1, y: 0 }, map: {}, mapUnread: true };
  assert.equal(wordsOf(world, { map: true }), "The robot's newest map cannot be read.");
  assert.equal(wordsOf(world, { map: false }), "");
});

test("a laser that has fallen silent is said to be, in the map and round the stick: nothing drawn would be free space", () => {
  const world = { robot: { x: 1, y: 0 }, isScanSilent: true, points: null, showRing() {} };
  assert.equal(wordsOf(world, { scan: true }), "The laser is silent.");
  assert.equal(wordsOf(world, { scan: false }), "");
  const said = [];
  globalThis.window = { devicePixelRatio: 1 };
  globalThis.requestAnimationFrame = (act) => act();
  const context = { fillRect() {}, fillText: (words) => said.push(words) };
  const ring = new LaserRing({ getContext: () => context, clientWidth: 100 }, world);
  ring.show(true);
  ring.world = { ...world, points: Float32Array.from([]) };
  ring.draw();
  assert.deepEqual(said, ["No laser"]);
});

test("what is ahead is up and what is at the left is left, as far as three metres, and what is near is said", () => {
  assert.deepEqual(ringPoints(Float32Array.from([1.5, 0, 0, 3, -0.75, 0, 3, 3])), [
    { x: 0, y: -0.5, near: false },
    { x: -1, y: 0, near: false },
    { x: 0, y: 0.25, near: true },
  ]);
});
