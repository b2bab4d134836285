import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Transforms, projected } from "../../src/overlays/transforms.js";

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
