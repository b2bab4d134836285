import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { LaserRing, ringPoints } from "../../src/overlays/laserRing.js";
import { MapTile, isLost, multiples, wordsOf } from "../../src/overlays/mapTile.js";
import { Transforms, projected } from "../../src/overlays/transforms.js";

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

const IDENTITY = { x: 0, y: 0, z: 0, w: 1 };
const LEFT = { x: 0, y: 0, z: Math.SQRT1_2, w: Math.SQRT1_2 }; // a quarter turn
const UPSIDE_DOWN = { x: 1, y: 0, z: 0, w: 0 }; // rolled by half a turn
const FACING_DOWN = { x: 0, y: Math.SQRT1_2, z: 0, w: Math.SQRT1_2 };

const link = (parent, child, [x, y, z] = [0, 0, 0], rotation = IDENTITY) => ({
  header: { frame_id: parent },
  child_frame_id: child,
  transform: { translation: { x, y, z }, rotation },
});

let transforms;

beforeEach(() => (transforms = new Transforms()));

const receive = (links, known = {}) => transforms.receive({ transforms: links }, { fixed: true, at: 0, ...known });

function seen(target, source, ...points) {
  const found = [...projected(Float32Array.from(points), transforms.find(target, source))];
  return found.map((value) => Math.round(value * 1000) / 1000 + 0);
}

test("a laser that hangs upside down sees left and right the other way round, and one that looks down a line", () => {
  receive([link("base_link", "hangs", [0, 0, 1], UPSIDE_DOWN), link("base_link", "down", [0.2, 0, 1], FACING_DOWN)]);
  assert.deepEqual(seen("base_link", "hangs", 2, 0, 0, 1), [2, 0, 0, -1]);
  assert.deepEqual(seen("base_link", "down", 2, 0, 0, 1), [0.2, 0, 0.2, 1]);
});

test("frames are joined up and down the tree, whatever slash they are written with", () => {
  receive([
    link("/base_footprint", "/base_link", [0, 0, 0.1]),
    link("base_link", "mast", [1, 0, 0], LEFT),
    link("mast", "laser", [0, 2, 0]),
  ]);
  receive([link("base_footprint", "wheel", [0, 1, 0])]);
  assert.deepEqual(seen("base_footprint", "laser", 0, 0, 2, 0), [-1, 0, -1, 2]);
  assert.deepEqual(seen("/wheel", "/laser", 0, 0), [-1, -1]);
  assert.deepEqual(seen("laser", "base_footprint", -1, 0), [0, 0]);
  assert.deepEqual(seen("laser", "laser", 1, 2), [1, 2]);
});

test("it is fixed if all its parts are, and as old as the oldest part that is not", () => {
  receive([link("base_link", "laser")], { at: 1 });
  receive([link("odom", "base_link")], { fixed: false, at: 5 });
  receive([link("map", "odom")], { fixed: false, at: 3 });
  assert.equal(transforms.find("base_link", "laser").fixed, true);
  const { fixed, at } = transforms.find("map", "laser");
  assert.deepEqual([fixed, at], [false, 3]);
});

test("frames that nothing connects, or that go in a circle, are found nowhere", () => {
  receive([link("a", "b"), link("b", "a"), link("c", "d")]);
  for (const [target, source] of [
    ["d", "a"],
    ["map", "c"],
    ["", ""],
    ["a", undefined],
  ]) {
    assert.equal(transforms.find(target, source), null);
  }
});

test("what is not a transform is left out, and the frames are bounded", () => {
  const nan = link("a", "nan", [NaN, 0, 0]);
  const zero = link("a", "zero", [0, 0, 0], { x: 0, y: 0, z: 0, w: 0 });
  receive([null, nan, zero, {}, { child_frame_id: 3, header: { frame_id: "a" } }]);
  transforms.receive({}, { fixed: true, at: 0 });
  assert.equal(transforms.frames.size, 0);
  const many = (from) => Array.from({ length: 1500 }, (_, i) => link("a", `frame${from + i}`));
  receive(many(0));
  receive(many(1500));
  assert.equal(transforms.frames.size, 1000);
});
