import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Gamepad, MAX_POLL_GAP_MS, usualProfile, DEAD_ZONE, readInput, fits, madeOf } from "../../src/input/gamepad.js";

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
});

// One look, a frame after the last, at a stick that is pushed forward and these buttons.
function see(...pressed) {
  seeAfter(FRAME_MS, ...pressed);
}

function seeAfter(ms, ...pressed) {
  at += ms;
  const buttons = [...Array(17).keys()].map((i) => pressed.includes(i));
  gamepad.see({ axes: [0, -1, 0, 0], buttons }, at);
}

const holds = () => told.filter((one) => one.timestamp);

test("a stick alone moves nothing; with the enable button it drives, until that is released", () => {
  see();
  assert.deepEqual(told, []);
  see(enable);
  assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0, turbo: false, timestamp: at }]);
  see();
  see();
  assert.equal(told.at(-1), "released");
  assert.equal(told.length, 2);
});

test("turbo counts while enable is held, and alone it moves nothing", () => {
  see(turbo);
  assert.deepEqual(told, []);
  see(enable, turbo);
  assert.equal(told.at(-1).turbo, true);
  assert.equal(states.at(-1), "turbo");
  see(enable);
  assert.equal(told.at(-1).turbo, false);
});

test("an enable button that is stuck when the gamepad comes moves nothing until released and pressed", () => {
  gamepad.forget();
  see(enable);
  see(enable);
  assert.deepEqual(told, []);
  assert.equal(states.at(-1), "stuck");
  see();
  see(enable);
  assert.equal(holds().length, 1);
});

test("after a drop the button that is still held does not drive on", () => {
  see(enable);
  gamepad.drop();
  see(enable);
  assert.equal(holds().length, 1);
  see();
  see(enable);
  assert.equal(holds().length, 2);
});

test("a press that did not count does not count later either", () => {
  armed = false;
  see(enable);
  armed = true;
  see(enable);
  assert.deepEqual(told, []);
  see();
  see(enable);
  assert.equal(holds().length, 1);
});

test("where driving ends without a word, the next look releases", () => {
  see(enable);
  armed = false;
  see(enable);
  assert.equal(told.at(-1), "released");
  assert.equal(states.at(-1), "off");
});

test("a late look renews nothing: enable may have been released meanwhile", () => {
  see(enable);
  seeAfter(MAX_POLL_GAP_MS + 1, enable);
  assert.equal(told.at(-1), "released");
  see(enable);
  assert.equal(holds().length, 1);
});

test("a look that is not so late drives on, each with its own timestamp", () => {
  see(enable);
  seeAfter(MAX_POLL_GAP_MS, enable);
  assert.deepEqual(
    holds().map(({ timestamp }) => timestamp),
    [at - MAX_POLL_GAP_MS, at],
  );
});

test("a gamepad that is gone is released once, and comes back as one that nobody has seen released", () => {
  see(enable);
  gamepad.forget();
  gamepad.forget();
  assert.deepEqual(told.slice(1), ["released"]);
  see(enable);
  assert.equal(holds().length, 1);
});

test("other settings let go of what is held", () => {
  see(enable);
  gamepad.use({ ...PROFILE, deadZone: 0.3 });
  assert.equal(told.at(-1), "released");
  see(enable);
  assert.equal(holds().length, 1);
});

test("the stop button stops once for each press, and whether driving counts or not", () => {
  armed = false;
  see(stop);
  see(stop);
  assert.deepEqual(told, ["stop"]);
  see();
  see(stop);
  assert.deepEqual(told, ["stop", "stop"]);
});

test("a stop button that is pressed at the first look stops: pressing it may be what made the gamepad seen", () => {
  gamepad.forget();
  see(stop);
  assert.deepEqual(told, ["stop"]);
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

test("a gamepad without a profile neither drives nor stops", () => {
  gamepad.use(null);
  see(enable, stop);
  assert.deepEqual(told, []);
  assert.equal(states.at(-1), "unknown");
});

const STANDARD = { mapping: "standard", axes: 4, buttons: 17 };
const NONE = Array(17).fill(false);
const profile = usualProfile(STANDARD, "differential");
const pushed = (axes, of = profile, buttons = NONE) => readInput(of, { axes, buttons });
const press = (index) => NONE.map((_, i) => i === index);

test("a known gamepad drives with its left stick: up is forward, left is a left turn", () => {
  assert.equal(pushed([0, -1, 0, 0]).forward, 1);
  assert.equal(pushed([-1, 0, 0, 0]).turn, 1);
  assert.equal(pushed([-1, 0, 0, 0]).left, 0);
});

test("on a robot that goes sideways the left stick does that and the right one turns", () => {
  const sideways = usualProfile(STANDARD, "holonomic");
  assert.deepEqual(pushed([-1, 0, 1, 0], sideways), { forward: 0, left: 1, turn: -1, turbo: false });
});

test("a device that the browser does not know, or with one stick, has no usual profile", () => {
  assert.equal(usualProfile({ ...STANDARD, mapping: "" }, "differential"), null);
  assert.equal(usualProfile({ ...STANDARD, axes: 2 }, "differential"), null);
});

test("within the dead zone nothing is asked for, and strength grows from its rim without a step", () => {
  const rim = DEAD_ZONE.usual;
  assert.equal(pushed([0, -rim, 0, 0]).forward, 0);
  assert.ok(pushed([0, -rim - 0.01, 0, 0]).forward < 0.02);
  assert.equal(pushed([0, -0.3, 0, 0], { ...profile, deadZone: 0.4 }).forward, 0);
});

test("an axis beyond its end counts as at its end, and one that is no number as at rest", () => {
  assert.equal(pushed([0, -1.4, 0, 0]).forward, 1);
  assert.equal(pushed([0, NaN, 0, 0]).forward, 0);
  assert.equal(pushed([]).forward, 0);
});

test("a stick that is inverted does the opposite", () => {
  const inverted = { ...profile, forward: { ...profile.forward, invert: true } };
  assert.equal(pushed([0, -1, 0, 0], inverted).forward, -1);
});

test("the turbo button asks for the higher limits, if there is one", () => {
  assert.equal(pushed([0, 0, 0, 0], profile, press(profile.turbo)).turbo, true);
  assert.equal(pushed([0, 0, 0, 0], { ...profile, turbo: null }, press(5)).turbo, false);
});

test("what was kept is used for a device with as many axes and buttons only", () => {
  const kept = JSON.parse(JSON.stringify(profile));
  assert.equal(fits(kept, STANDARD), true);
  assert.equal(fits(kept, { ...STANDARD, axes: 6 }), false);
  assert.equal(fits(kept, { ...STANDARD, buttons: 12 }), false);
});

const SPOILT = {
  "nothing at all": null,
  "a text": "forward",
  "another version": { ...profile, version: 0 },
  "an axis that there is not": { ...profile, turn: { ...profile.turn, axis: 4 } },
  "no axis for forward": { ...profile, forward: null },
  "a sign that would make it faster": { ...profile, forward: { ...profile.forward, sign: 5 } },
  "no enable button": { ...profile, enable: null },
  "a stop button that there is not": { ...profile, stop: 17 },
  "no dead zone": { ...profile, deadZone: 0 },
};

for (const [what, kept] of Object.entries(SPOILT)) {
  test(`what was kept is not used when it is ${what}`, () => {
    assert.equal(fits(kept, STANDARD), false);
  });
}

test("what was learnt makes a profile that fits its device", () => {
  const device = { axes: 3, buttons: 4 };
  const learnt = { forward: { axis: 2, sign: 1 }, turn: { axis: 0, sign: -1 }, enable: 3 };
  const made = madeOf(learnt, device);
  assert.equal(fits(made, device), true);
  assert.deepEqual([made.left, made.turbo, made.stop], [null, null, null]);
  assert.equal(readInput(made, { axes: [0, 0, 1], buttons: [] }).forward, 1);
});

test("what was learnt of a device fits it only as long as the browser counts its axes in the same order", () => {
  const raw = { mapping: "", axes: 4, buttons: 17 };
  const learnt = madeOf({ forward: { axis: 3, sign: -1 }, turn: { axis: 2, sign: -1 }, enable: 4 }, raw);
  const kept = JSON.parse(JSON.stringify(learnt));
  assert.equal(fits(kept, raw), true);
  assert.equal(fits(kept, STANDARD), false);
});
