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

test("sticks and buttons are learnt one after the other, each after all was let go", () => {
  hold();
  act({ 1: -0.9 });
  act({ 0: 0.8 });
  act({}, [6]);
  act({}, [7]);
  act({}, [2]);
  assert.deepEqual(learnt, { rest: 0.05, forward: { axis: 1, sign: -1 }, turn: { axis: 0, sign: 1 }, enable: 6, turbo: 7, stop: 2 });
  assert.deepEqual(asked.slice(0, 4), ["forward rest", "forward move", "forward back", "turn move"]);
});

test("a robot that goes sideways is asked for that too", () => {
  assert.deepEqual(stepsOf("holonomic").slice(0, 3), ["forward", "left", "turn"]);
  assert.ok(!stepsOf("ackermann").includes("left"));
});

test("it does not begin while something moves or is pressed", () => {
  hold({}, [3]);
  assert.deepEqual(asked, ["forward rest"]);
  for (let i = 0; i < 60; i++) learner.see({ axes: [i / 60, 0, -1, 3.28], buttons: [] }, (at += 16));
  assert.deepEqual(asked, ["forward rest"]);
  hold();
  assert.equal(asked.at(-1), "forward move");
});

test("a small push, a diagonal and a touch in passing are not taken", () => {
  hold();
  act({ 1: -0.5 });
  act({ 0: 0.8, 1: -0.9 });
  learner.see({ axes: [0, -1, -1, 3.28], buttons: [] }, at);
  hold();
  assert.equal(asked.at(-1), "forward move");
});

test("what rests at an end of its way is no stick", () => {
  hold();
  act({ 2: 1 });
  act({ 3: -1 });
  assert.equal(asked.at(-1), "forward move");
});

test("a stick or button that does something already is not taken for another thing", () => {
  hold();
  act({ 1: -1 });
  act({ 1: 1 });
  assert.equal(asked.at(-1), "turn move");
  act({ 0: -1 });
  act({}, [4]);
  act({}, [4]);
  assert.equal(asked.at(-1), "turbo move");
});

test("the next thing is not asked for while the last is still held", () => {
  hold();
  hold({ 1: -1 });
  assert.equal(asked.at(-1), "forward back");
  hold({ 1: -1 });
  assert.equal(asked.at(-1), "forward back");
});

test("turbo and stop may be left out, the enable button may not", () => {
  hold();
  act({ 1: -1 });
  act({ 0: -1 });
  learner.pass();
  assert.equal(asked.at(-1), "enable move");
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
