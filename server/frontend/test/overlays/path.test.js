import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Path } from "../../src/overlays/world.js";

let path;

beforeEach(() => {
  path = new Path();
});

test("a robot that stands adds nothing", () => {
  assert.equal(path.add({ x: 0, y: 0 }), true);
  assert.equal(path.add({ x: 0.01, y: 0 }), false);
  assert.equal(path.add({ x: 0.2, y: 0 }), true);
  assert.equal(path.add({ x: NaN, y: 0 }), false);
  assert.equal(path.points.length, 2);
});

test("a day's way keeps its beginning and its end in bounded room", () => {
  for (let i = 0; i <= 50_000; i++) path.add({ x: i / 10, y: 0 });
  assert.ok(path.points.length <= 2000);
  assert.equal(path.points[0].x, 0);
  assert.ok(5000 - path.points.at(-1).x < 5);
});

test("odometry that begins anew begins a new path", () => {
  path.add({ x: 40, y: 0 });
  path.add({ x: 0, y: 0 });
  assert.deepEqual(path.points, [{ x: 0, y: 0 }]);
});
