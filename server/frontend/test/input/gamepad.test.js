import assert from "node:assert/strict";
import { beforeEach, describe, test } from "node:test";

import { DEAD_ZONE, Gamepad, MAX_POLL_GAP_MS, fits, madeOf, readInput, usualProfile } from "../../src/input/gamepad.js";
import { Learner, stepsOf } from "../../src/input/gamepadLearn.js";

const PROFILE = usualProfile({ mapping: "standard", axes: 4, buttons: 17 }, "differential");
const { enable, turbo, stop } = PROFILE;
const FRAME_MS = 16;

let told, states, armed, at, gamepad;

beforeEach(() => {
  told = [];
  states = [];
  armed = true;
  at = 1000;
  gamepad = new Gamepad({
    accepts: () => armed,
    onHold: (input, timestamp) => told.push({ ...input, timestamp }),
    onRelease: () => told.push("released"),
    onStop: () => told.push("stop"),
    onState: (state) => states.push(state),
  });
  gamepad.use(PROFILE);
  see();
  centre();
});

function centre() {
  gamepad.see({ axes: [0, 0, 0, 0], buttons: Array(17).fill(false) }, (at += FRAME_MS));
}

// One look, a frame after the last, at a stick that is pushed forward and these buttons.
function see(...pressed) {
  seeAfter(FRAME_MS, ...pressed);
}

function seeAfter(ms, ...pressed) {
  at += ms;
  const buttons = [...Array(17).keys()].map((i) => pressed.includes(i));
  gamepad.see({ axes: [0, -1, 0, 0], buttons }, at);
}

// What was reported, in words.
const report = () => told.map((input) => (typeof input === "string" ? input : input.turbo ? "turbo" : "hold")).join(" ");

test("with the enable button the stick drives, each look with its own timestamp, until the button is released", () => {
  see();
  see(enable);
  assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0, turbo: false, timestamp: at }]);
  seeAfter(MAX_POLL_GAP_MS, enable);
  assert.equal(told[1].timestamp, at);
  see();
  see();
  assert.equal(report(), "hold hold released");
});

for (const [name, act, expected] of [
  ["turbo counts while enable is held, and alone it moves nothing", () => [see(turbo), see(enable, turbo), see(enable)], "turbo hold"],
  ["a stuck enable button must be released first", () => [gamepad.forget(), see(enable), see(enable), see(), see(enable)], "hold"],
  ["after a drop it must be pressed anew", () => [see(enable), gamepad.drop(), see(enable), see(), see(enable)], "hold hold"],
  ["a press that did not count does not later", () => [(armed = false), see(enable), (armed = true), see(enable), see()], ""],
  ["where driving ends, the next look releases", () => [see(enable), (armed = false), see(enable)], "hold released"],
  ["a late look renews nothing", () => [see(enable), seeAfter(MAX_POLL_GAP_MS + 1, enable), see(enable)], "hold released"],
  ["one that is gone is released once", () => [see(enable), gamepad.forget(), gamepad.forget(), see(enable)], "hold released"],
  ["other settings let go", () => [see(enable), gamepad.use({ ...PROFILE, deadZone: 0.3 }), see(enable)], "hold released"],
  ["each press of the stop button counts", () => [(armed = false), see(stop), see(stop), see(), see(stop)], "stop stop"],
  ["a stop button that made the gamepad seen stops", () => [see(stop), gamepad.forget(), see(stop)], "stop stop"],
  ["without a profile it neither drives nor stops", () => [gamepad.use(null), see(enable, stop)], ""],
]) {
  test(name, () => {
    act();
    assert.equal(report(), expected);
  });
}

for (const [state, act] of Object.entries({
  ready: () => see(),
  driving: () => see(enable),
  turbo: () => see(enable, turbo),
  stuck: () => [gamepad.forget(), see(enable)],
  off: () => [(armed = false), see(enable)],
  uncentred: () => [gamepad.use(PROFILE), see(), see(enable)],
  unknown: () => [gamepad.use(null), see(enable)],
})) {
  test(`the state ${state} is reported`, () => {
    act();
    assert.equal(states.at(-1), state);
  });
}

test("a stick that was never seen at its centre drives nothing", () => {
  gamepad.use(PROFILE);
  see();
  see(enable);
  assert.equal(told.at(-1).forward, 0);
  centre();
  see(enable);
  assert.equal(told.at(-1).forward, 1);
});

test("a stop lets go before the same look could drive on", () => {
  gamepad.handlers.onStop = () => {
    told.push("stop");
    gamepad.drop(); // as teleop.js does when it halts
  };
  see(enable);
  see(enable, stop);
  see(enable);
  assert.deepEqual(told.slice(1), ["stop"]);
});

const STANDARD = { mapping: "standard", axes: 4, buttons: 17 };
const profile = usualProfile(STANDARD, "differential");
const buttons = Array(17).fill(false);
const push = (axes, of = profile, pressed = buttons) => readInput(of, { axes, buttons: pressed });

for (const [what, axes, changes, expected] of [
  ["up is forward", [0, -1, 0, 0], {}, { forward: 1 }],
  ["left is a left turn", [-1, 0, 0, 0], {}, { turn: 1 }],
  ["the dead zone asks for nothing", [0, -DEAD_ZONE.usual, 0, 0], {}, {}],
  ["a wider dead zone asks for nothing", [0, -0.3, 0, 0], { deadZone: 0.4 }, {}],
  ["an axis beyond its end counts as at its end", [0, -1.4, 0, 0], {}, { forward: 1 }],
  ["an axis that is not a number is at rest", [0, NaN, 0, 0], {}, {}],
  ["an axis that there is not is at rest", [], {}, {}],
  ["a stick that is inverted does the opposite", [0, -1, 0, 0], { forward: { ...profile.forward, invert: true } }, { forward: -1 }],
]) {
  test(`of a known gamepad's left stick ${what}`, () => {
    assert.deepEqual(push(axes, { ...profile, ...changes }), { forward: 0, left: 0, turn: 0, turbo: false, ...expected });
  });
}

test("strength grows from the rim of the dead zone without a step", () => {
  assert.ok(push([0, -DEAD_ZONE.usual - 0.01, 0, 0]).forward < 0.02);
});

test("on a robot that goes sideways the left stick does that and the right one turns", () => {
  const sideways = usualProfile(STANDARD, "holonomic");
  assert.deepEqual(push([-1, 0, 1, 0], sideways), { forward: 0, left: 1, turn: -1, turbo: false });
});

test("a device that the browser does not know, or with one stick, has no usual profile", () => {
  for (const device of [{ mapping: "" }, { axes: 2 }, { buttons: 4 }])
    assert.equal(usualProfile({ ...STANDARD, ...device }, "differential"), null);
});

test("what was kept is used again", () => assert.equal(fits(JSON.parse(JSON.stringify(profile)), STANDARD), true));

const SPOILT = {
  "nothing at all": null,
  "another version": { ...profile, version: 0 },
  "of a device with other axes": { ...profile, axes: 6 },
  "of the same device, whose axes the browser counts in another order": { ...profile, mapping: "" },
  "an axis that there is not": { ...profile, turn: { ...profile.turn, axis: 4 } },
  "no axis for forward": { ...profile, forward: null },
  "a sign that would make it faster": { ...profile, forward: { ...profile.forward, sign: 5 } },
  "no enable button": { ...profile, enable: null },
  "a stop button that there is not": { ...profile, stop: 17 },
};

for (const [what, kept] of Object.entries(SPOILT)) {
  test(`what was kept is not used when it is ${what}`, () => assert.equal(fits(kept, STANDARD), false));
}

describe("a device that is learnt", () => {
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
});
