import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Limits } from "../../src/input/controls.js";

let limits;

beforeEach(() => {
  limits = new Limits({ maxLinear: 1, maxAngular: 2 });
});

test("limits start at the robot's own", () => {
  assert.deepEqual([limits.linear, limits.angular], [1, 2]);
});

test("turbo is a share of the robot's own limits, and never slower than without", () => {
  Object.assign(limits, { linear: 0.2, angular: 1.5, share: 0.5 });
  assert.deepEqual(limits.turbo, { linear: 0.5, angular: 1.5 });
});

test("turbo never goes beyond the robot's own limits", () => {
  assert.deepEqual(limits.turbo, limits.most);
});
