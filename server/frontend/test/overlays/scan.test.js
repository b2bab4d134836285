import assert from "node:assert/strict";
import { test } from "node:test";

import { scanPoints } from "../../src/overlays/world.js";

const scan = { angle_min: -Math.PI / 2, angle_increment: Math.PI / 2, range_min: 0.1, range_max: 10, ranges: [1, 2, 3] };
const rounded = (points) => [...points].map((value) => Math.round(value * 1000) / 1000 + 0);

test("ranges become points around the sensor, x ahead and y to the left", () => {
  assert.deepEqual(rounded(scanPoints(scan)), [0, -1, 2, 0, 0, 3]);
});

test("what the sensor did not see is left out, whatever stands for it", () => {
  const ranges = [null, NaN, Infinity, 0.05, 11, 2];
  assert.equal(scanPoints({ ...scan, ranges }).length, 2);
});

test("a scan without a range limit shows all that is a number", () => {
  assert.equal(scanPoints({ ...scan, range_max: 0 }).length, 6);
});

test("a very fine scan is thinned out", () => {
  const points = scanPoints({ ...scan, ranges: new Array(40_000).fill(1) });
  assert.ok(points.length / 2 <= 1500 && points.length / 2 > 1000);
});
