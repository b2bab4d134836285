import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Sleep, VideoInterlock } from "../../src/control/arming.js";

let clock, wall, changes, hold;

function make(afterMs = 1000) {
  changes = [];
  hold = new VideoInterlock({ afterMs, onChange: () => changes.push(hold.kind), now: () => clock, wall: () => wall });
}

beforeEach(() => {
  clock = 5000;
  wall = 1_000_000;
  make();
});

function pass(ms) {
  clock += ms;
  wall += ms;
  hold.check();
}

const see = (ageMs) => hold.receive({ offered: true, at: clock - ageMs });

test("driving is held until the first picture, which grows old by itself", () => {
  assert.equal(hold.held, true);
  see(40);
  pass(960);
  assert.equal(hold.held, false);
  pass(1);
  assert.equal(hold.held, true);
  assert.deepEqual(changes, ["seen", "old"]);
});

test("the limit is the robot's, whatever the picture itself calls old", () => {
  make(3000);
  see(2500);
  assert.equal(hold.held, false);
  make(300);
  see(400);
  assert.equal(hold.held, true);
});

test("a picture that is lost, or has no age, holds at once", () => {
  for (const at of [null, NaN]) {
    see(10);
    hold.receive({ offered: true, at });
    assert.deepEqual([hold.kind, hold.held], ["missing", true]);
  }
});

test("a robot without a camera is never held, nor one whose settings say so", () => {
  hold.receive({ offered: false, at: null });
  assert.equal(hold.held, false);
  make(null);
  hold.receive({ offered: true, at: null });
  pass(60_000);
  assert.equal(hold.held, false);
});

test("a person may drive without the picture until it is back, and then not again", () => {
  hold.allow();
  assert.equal(hold.kind, "blind");
  hold.receive({ offered: true, at: null });
  pass(10_000);
  assert.equal(hold.held, false);
  see(10);
  pass(2000);
  assert.equal(hold.kind, "old");
  assert.deepEqual(changes, ["blind", "seen", "old"]);
});

test("what was allowed on one link is not on the next", () => {
  hold.allow();
  hold.revoke();
  assert.equal(hold.held, true);
});

test("after a sleep of the machine, in which the clock of ages stood, only a newer picture counts", () => {
  see(10);
  wall += 60_000;
  hold.check();
  assert.equal(hold.kind, "old");
  clock += 50;
  wall += 50;
  see(60); // still the one from before the sleep
  assert.equal(hold.kind, "old");
  clock += 50;
  wall += 50;
  see(20);
  assert.equal(hold.kind, "seen");
});

test("between two checks all read the same, so that none misses a change", () => {
  see(990);
  clock += 20;
  wall += 20;
  assert.equal(hold.kind, "seen");
  see(5);
  assert.deepEqual(changes, ["seen"]);
  clock += 1001;
  wall += 1001;
  hold.check();
  assert.equal(hold.held, true);
  assert.deepEqual(changes, ["seen", "old"]);
});

test("a machine that slept, or whose time of day was set, is told from one that was busy", () => {
  const sleep = new Sleep();
  assert.equal(sleep.isOver(0, 1_000_000), false);
  assert.equal(sleep.isOver(5000, 1_005_010), false);
  assert.equal(sleep.isOver(5100, 1_065_110), true);
  assert.equal(sleep.isOver(5200, 1_065_210), false);
  assert.equal(sleep.isOver(5300, 1_000_000), true);
});
