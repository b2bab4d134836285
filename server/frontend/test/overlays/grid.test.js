import assert from "node:assert/strict";
import { test } from "node:test";

import { planar } from "../../src/client/rosbridge.js";
import { gridPixels } from "../../src/overlays/world.js";

const info = { width: 2, height: 2, resolution: 0.5, origin: { position: { x: -1, y: 2, z: 0 }, orientation: { x: 0, y: 0, z: 1, w: 0 } } };

test("free is dark, occupied is light, unknown is nothing", () => {
  const { pixels } = gridPixels({ info, data: [0, 100, -1, 50] });
  const alphas = [3, 7, 11, 15].map((at) => pixels[at]);
  assert.deepEqual(alphas, [255, 255, 0, 255]);
  assert.ok(pixels[0] < pixels[12] && pixels[12] < pixels[4]);
});

test("a map keeps its place and its scale", () => {
  const grid = gridPixels({ info, data: [0, 0, 0, 0] });
  assert.deepEqual([grid.width, grid.height, grid.resolution], [2, 2, 0.5]);
  assert.deepEqual([grid.origin.x, grid.origin.y], [-1, 2]);
  assert.ok(Math.abs(Math.abs(grid.origin.theta) - Math.PI) < 1e-9);
});

test("bytes in base64 are the same map", () => {
  const data = btoa(String.fromCharCode(0, 100, 255, 50));
  assert.deepEqual(gridPixels({ info, data }).pixels, gridPixels({ info, data: [0, 100, -1, 50] }).pixels);
});

test("what does not fit together is no map", () => {
  assert.equal(gridPixels({ info, data: [0] }), null);
  assert.equal(gridPixels({ info: { ...info, resolution: 0 }, data: [0, 0, 0, 0] }), null);
  assert.equal(gridPixels({ info: { ...info, width: 1e6, height: 1e6 }, data: [] }), null);
  assert.equal(gridPixels({}), null);
});

test("a map that is not turned may leave its orientation unset, but not its place", () => {
  const at = (origin) => gridPixels({ info: { ...info, origin }, data: [0, 0, 0, 0] })?.origin;
  const { position } = info.origin;
  assert.deepEqual(at({ position, orientation: { x: 0, y: 0, z: 0, w: 0 } }), { x: -1, y: 2, theta: 0 });
  assert.deepEqual(at({ position: { ...position, x: null } }), undefined);
});

test("a pose without place or heading is unknown", () => {
  const { position, orientation } = info.origin;
  assert.notEqual(planar({ position, orientation }), null);
  assert.equal(planar(), null);
  assert.equal(planar({ position, orientation: { x: 0, y: 0, z: 0, w: 0 } }), null);
  assert.equal(planar({ position: { ...position, y: null }, orientation }), null);
});
