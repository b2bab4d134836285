import assert from "node:assert/strict";
import { test } from "node:test";

import { mixed } from "../../src/client/teleop.js";

const LIMITS = {
  linear: 0.5,
  angular: 2,
  turbo: { linear: 1, angular: 3 },
  most: { linear: 1, angular: 3 },
};
const input = (forward, left, turn, more = {}) => ({ forward, left, turn, ...more });

test("inputs add up to no more than the limit, and opposite ones cancel", () => {
  const both = [input(1, 0, 1), input(1, 0, -1)];
  assert.deepEqual(mixed(both, LIMITS, "differential"), { forward: 0.5, left: 0, turn: 0 });
  assert.deepEqual(mixed([], LIMITS, "holonomic"), { forward: 0, left: 0, turn: 0 });
});

test("only a robot that can go sideways is told to", () => {
  assert.equal(mixed([input(0, 1, 0)], LIMITS, "differential").left, 0);
  assert.equal(mixed([input(0, 1, 0)], LIMITS, "ackermann").left, 0);
  assert.equal(mixed([input(0, 1, 0)], LIMITS, "holonomic").left, 0.5);
});

test("the limit holds for the speed along a diagonal too", () => {
  const { forward, left, turn } = mixed([input(1, -1, 1)], LIMITS, "holonomic");
  assert.ok(Math.abs(Math.hypot(forward, left) - 0.5) < 1e-9);
  assert.equal(left, -forward);
  assert.equal(turn, 2);
});

test("the higher limits count for as long as an input asks for them", () => {
  const pad = [input(1, 0, 1, { turbo: true })];
  assert.deepEqual(mixed(pad, LIMITS, "differential"), { forward: 1, left: 0, turn: 3 });
  assert.equal(mixed(pad, { linear: 0.5, angular: 2 }, "differential").forward, 0.5);
});

test("a car does not turn in place, and turns the other way as it backs", () => {
  assert.deepEqual(mixed([input(0, 0, 1)], LIMITS, "ackermann"), { forward: 0, left: 0, turn: 0 });
  assert.equal(mixed([input(1, 0, 1)], LIMITS, "ackermann").turn, 1);
  assert.equal(mixed([input(-1, 0, 1)], LIMITS, "ackermann").turn, -1);
});

test("a car's curve is the stick's, whatever the speed, and its turn stays within the limit", () => {
  const curve = ({ forward, turn }) => turn / forward;
  const fast = mixed([input(1, 0, 0.5)], LIMITS, "ackermann");
  const slow = mixed([input(0.2, 0, 0.5)], LIMITS, "ackermann");
  assert.ok(Math.abs(curve(fast) - curve(slow)) < 1e-9);
  assert.equal(mixed([input(1, 0, 1, { turbo: true })], LIMITS, "ackermann").turn, 3);
});
