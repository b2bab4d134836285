import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Limits } from "../../src/input/controls.js";

let limits;

beforeEach(() => {
  limits = new Limits({ maxLinear: 1, maxAngular: 2 });
});

test("limits start at the normal speed", () => {
  assert.deepEqual([limits.linear, limits.angular], [0.6, 1.2]);
});

test("limits start as they were chosen before, but for what is no share", () => {
  const { chosen } = new Limits({ maxLinear: 1, maxAngular: 2 }, undefined, { linear: 0.3, angular: 7 });
  assert.deepEqual(chosen, { linear: 0.3, angular: 0.6 });
});

test("a step is faster or slower than chosen while it is held, and never beyond the robot's own or below slow", () => {
  const speeds = (by) => {
    limits.step(by);
    return [limits.linear, limits.angular];
  };
  assert.deepEqual(
    [speeds(1), speeds(-1), speeds(0)],
    [
      [1, 2],
      [0.3, 0.6],
      [0.6, 1.2],
    ],
  );
  limits.chosen = { linear: 1, angular: 0.3 };
  assert.deepEqual(
    [speeds(1), speeds(-1)],
    [
      [1, 1.2],
      [0.6, 0.6],
    ],
  );
  limits.chosen = { linear: 0.05, angular: 0.05 };
  assert.deepEqual(speeds(-1), [0.05, 0.1]);
});

test("turbo is a share of the robot's own limits, and never slower than without", () => {
  Object.assign(limits, { chosen: { linear: 0.2, angular: 0.75 }, share: 0.5 });
  assert.deepEqual(limits.turbo, { linear: 0.5, angular: 1.5 });
});

test("turbo never goes beyond the robot's own limits", () => {
  limits.step(1);
  assert.deepEqual(limits.turbo, limits.most);
});
