import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Sleep, VideoInterlock } from "../../src/control/arming.js";

let clock, wall, changes, interlock;

function make(afterMs = 1000) {
  changes = [];
  interlock = new VideoInterlock({ afterMs, onChange: () => changes.push(interlock.kind), now: () => clock, wall: () => wall });
}

beforeEach(() => {
  clock = 5000;
  wall = 1_000_000;
  make();
});

function pass(ms, check = true) {
  clock += ms;
  wall += ms;
  if (check) interlock.check();
}

function sleep(ms) {
  wall += ms;
  interlock.check();
}

const see = (ageMs) => interlock.receive({ offered: true, at: clock - ageMs });
const lose = () => interlock.receive({ offered: true, at: null });

// How the kind changes by some steps; it is missing to begin with.
for (const [name, act, ...kinds] of [
  ["driving is held until the first frame", () => {}],
  ["a frame lets it go on", () => see(40), "seen"],
  ["a frame is good up to its time limit", () => [see(40), pass(960)], "seen"],
  ["a frame grows old by itself", () => [see(40), pass(961)], "seen", "old"],
  ["a frame that is lost holds at once", () => [see(10), lose()], "seen", "missing"],
  ["a reading without an age is no frame", () => [see(10), see(NaN)], "seen", "missing"],
  ["the limit is the robot's, and may be longer", () => [make(3000), see(2500)], "seen"],
  ["the limit is the robot's, and may be shorter", () => [make(300), see(400)], "old"],
  ["a robot without a camera is never held", () => interlock.receive({ offered: false, at: null }), "off"],
  ["a person may drive without video", () => [interlock.allow(), lose(), pass(10_000)], "blind"],
  ["until it is back, and then not again", () => [interlock.allow(), see(10), pass(2000)], "blind", "seen", "old"],
  ["what was allowed on one link is not on the next", () => [interlock.allow(), interlock.revoke()], "blind", "missing"],
  ["after a sleep, in which the clock of ages stood, a frame is old", () => [see(10), sleep(60_000)], "seen", "old"],
  ["one from before the sleep does not count", () => [see(10), sleep(60_000), pass(50), see(60)], "seen", "old"],
  ["only a newer one does", () => [see(10), sleep(60_000), pass(50), see(60), pass(50), see(20)], "seen", "old", "seen"],
  ["between two checks all read the same", () => [see(990), pass(20, false)], "seen"],
  ["so that none misses a change", () => [see(990), pass(20, false), see(5), pass(1001)], "seen", "old"],
]) {
  test(name, () => {
    act();
    const kind = kinds.at(-1) ?? "missing";
    assert.deepEqual([changes, interlock.kind, interlock.held], [kinds, kind, ["missing", "old"].includes(kind)]);
  });
}

test("a robot whose settings say so is never held", () => {
  make(null);
  lose();
  pass(60_000);
  assert.deepEqual([interlock.kind, interlock.held, changes], ["off", false, []]);
});

test("a machine that slept, or whose time of day was set, is distinguished from one that was busy", () => {
  const sleep = new Sleep();
  const looks = [sleep.isOver(0, 1_000_000), sleep.isOver(5000, 1_005_010), sleep.isOver(5100, 1_065_110)];
  assert.deepEqual(looks, [false, false, true]);
  assert.deepEqual([sleep.isOver(5200, 1_065_210), sleep.isOver(5300, 1_000_000)], [false, true]);
});
