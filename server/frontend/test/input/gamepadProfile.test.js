import assert from "node:assert/strict";
import { test } from "node:test";

import { DEAD_ZONE, asked, fits, madeOf, usualProfile } from "../../src/input/gamepad.js";

const STANDARD = { mapping: "standard", axes: 4, buttons: 17 };
const NONE = Array(17).fill(false);
const profile = usualProfile(STANDARD, "differential");
const pushed = (axes, of = profile, buttons = NONE) => asked(of, { axes, buttons });
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
  assert.equal(asked(made, { axes: [0, 0, 1], buttons: [] }).forward, 1);
});

test("what was learnt of a device fits it only as long as the browser counts its axes in the same order", () => {
  const raw = { mapping: "", axes: 4, buttons: 17 };
  const learnt = madeOf({ forward: { axis: 3, sign: -1 }, turn: { axis: 2, sign: -1 }, enable: 4 }, raw);
  const kept = JSON.parse(JSON.stringify(learnt));
  assert.equal(fits(kept, raw), true);
  assert.equal(fits(kept, STANDARD), false);
});
