import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { readInput, fits, madeOf } from "../../src/input/gamepad.js";
import { Learner, stepsOf } from "../../src/input/gamepadLearn.js";

const REST = [0, 0, -1, 3.28]; // two axes of a stick, a trigger, a cross

let asked, learnt, at, learner;

beforeEach(() => {
  asked = [];
  learnt = null;
  at = 0;
  learner = start("differential");
});

function start(kind) {
  return new Learner({ steps: stepsOf(kind), onAsk: (...what) => asked.push(what.join(" ")), onDone: (what) => (learnt = what) });
}

// What is held for half a second, looked at 60 times a second.
function hold(axes = {}, pressed = []) {
  const positions = REST.map((rest, i) => axes[i] ?? rest);
  const buttons = [...Array(8).keys()].map((i) => pressed.includes(i));
  for (const end = at + 500; at < end; at += 16) learner.see({ axes: positions, buttons }, at);
}

function act(axes, pressed) {
  hold(axes, pressed);
  hold();
}

test("a robot that goes sideways is asked for that too", () => {
  assert.deepEqual(stepsOf("holonomic").slice(0, 3), ["forward", "left", "turn"]);
  assert.ok(!stepsOf("ackermann").includes("left"));
});

const drift = () => [...Array(60).keys()].forEach((i) => learner.see({ axes: [i / 60, 0, -1, 3.28], buttons: [] }, (at += 16)));
const touch = () => learner.see({ axes: [0, -1, -1, 3.28], buttons: [] }, at);
const learnSticks = () => [hold(), act({ 1: -1 }), act({ 0: -1 })];

// What is asked for after some moves.
for (const [name, moves, next] of [
  ["it does not begin while a button is pressed", () => hold({}, [3]), "forward rest"],
  ["nor while something moves", drift, "forward rest"],
  ["it begins when all is at rest", () => [drift(), hold()], "forward move"],
  ["a small push is not taken", () => [hold(), act({ 1: -0.5 })], "forward move"],
  ["nor a diagonal", () => [hold(), act({ 0: 0.8, 1: -0.9 })], "forward move"],
  ["nor a touch in passing", () => [hold(), touch(), hold()], "forward move"],
  ["what rests at an end of its way is no stick", () => [hold(), act({ 2: 1 }), act({ 3: -1 })], "forward move"],
  ["nothing is asked for while the last is still held", () => [hold(), hold({ 1: -1 }), hold({ 1: -1 })], "forward back"],
  ["a stick that does something is not taken for another thing", () => [hold(), act({ 1: -1 }), act({ 1: 1 })], "turn move"],
  ["nor is a button", () => [learnSticks(), act({}, [4]), act({}, [4])], "turbo move"],
  ["the enable button may not be left out", () => [learnSticks(), learner.pass()], "enable move"],
]) {
  test(name, () => {
    moves();
    assert.equal(asked.at(-1), next);
  });
}

test("a trigger that says 0 until it is touched is learnt as a button, and is no stick", () => {
  for (const untouched of [{}, { 1: -1 }, {}, { 0: -1 }, {}]) hold({ 2: 0, ...untouched });
  hold({ 2: 1 }, [6]);
  hold({ 2: -1 });
  assert.deepEqual([learner.learnt.enable, asked.at(-1)], [6, "turbo move"]);
});

test("turbo and stop may be left out", () => {
  learnSticks();
  act({}, [0]);
  learner.pass();
  learner.pass();
  assert.deepEqual([learnt.enable, "turbo" in learnt, "stop" in learnt], [0, false, false]);
});

for (const rest of [0.3, -0.35]) {
  test(`a worn stick that rests at ${rest} moves nothing until it is pushed`, () => {
    const still = { 1: rest };
    hold(still);
    for (const moved of [{ 1: -1 }, { 1: rest, 0: -1 }]) {
      hold(moved);
      hold(still);
    }
    for (const button of [4, 5, 6]) {
      hold(still, [button]);
      hold(still);
    }
    const device = { axes: 4, buttons: 8 };
    const profile = madeOf(learnt, device);
    assert.ok(fits(profile, device));
    const buttons = Array(8).fill(false);
    assert.equal(readInput(profile, { axes: [0, rest, -1, 3.28], buttons }).forward, 0);
    assert.equal(readInput(profile, { axes: [0, -1, -1, 3.28], buttons }).forward, 1);
  });
}
