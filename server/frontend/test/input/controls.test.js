import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Limits, setUpLimits } from "../../src/input/controls.js";

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

// As much of the page as the speeds need.
function speedsOnPage() {
  const element = (dataset) => Object.assign(new EventTarget(), { dataset, setAttribute() {} });
  const buttons = ["0.3", "0.6", "1"].map((step) => element({ step }));
  const others = new Map();
  const root = {
    querySelectorAll: () => buttons,
    querySelector: (selector) => others.get(selector) ?? others.set(selector, element({})).get(selector),
  };
  return { slow: buttons[0], limits: setUpLimits(root, { maxLinear: 1, maxAngular: 2 }, { all: {}, keep() {} }) };
}

test("a finger beside the one on the stick, which makes no click, chooses a speed as well", () => {
  const { slow, limits } = speedsOnPage();
  slow.dispatchEvent(Object.assign(new Event("pointerup"), { isPrimary: false, pointerType: "touch" }));
  assert.deepEqual([limits.linear, limits.angular], [0.3, 0.6]);
});
