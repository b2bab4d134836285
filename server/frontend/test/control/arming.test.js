import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Teleop } from "../../src/client/teleop.js";
import { Arming, Sleep, VideoInterlock } from "../../src/control/arming.js";

const FORWARD = { forward: 1, left: 0, turn: 0 };
const STILL = { forward: 0, left: 0, turn: 0 };
const CHECK_MS = 50;

let clock, slept, sent, changes, mayMove, watches, takes, teleop, interlock, arming;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = 1000;
  slept = takes = 0;
  mayMove = true;
  watches = false;
  make();
});

function make(afterMs = 1000) {
  [sent, changes] = [[], []];
  const onChange = () => {
    changes.push(interlock.kind);
    arming.update({ mayMove, watches, free: watches });
  };
  interlock = new VideoInterlock({ afterMs, onChange, now: () => clock, wall: () => clock + slept });
  arming = new Arming({ interlock, output: { mayQueue: true, publish: (twist) => sent.push({ ...twist, at: clock }) } });
  teleop = new Teleop({
    output: arming,
    limits: { linear: 1, angular: 1 },
    onTake: () => (takes += 1),
    now: () => clock,
    timestamp: () => clock,
  });
  arming.use(teleop);
  arming.update({ mayMove, watches, free: watches });
}

// With the page's own timer for the check, or without, as if that were late.
function pass(ms, checks = true) {
  for (let left = ms; left > 0; left -= 10) {
    clock += 10;
    mock.timers.tick(10);
    if (checks && clock % CHECK_MS === 0) interlock.check();
  }
}

// A sleep of the machine, in which the clock of ages stands still.
function sleep(ms) {
  slept += ms;
  interlock.check();
}

const see = (ageMs = 0) => interlock.receive({ offered: true, at: clock - ageMs });
const lose = () => interlock.receive({ offered: true, at: null });
const moving = () => sent.filter(({ forward }) => forward !== 0);

for (const checks of [true, false]) {
  test(`a key that is held while the frame grows old ends in zeros within 100 ms, ${checks ? "by" : "without"} the page's timer`, () => {
    see();
    teleop.hold("keyboard", FORWARD);
    getControl(); // is no news
    pass(2000, checks);
    const last = moving().at(-1).at;
    const zero = sent.find(({ forward }) => forward === 0);
    assert.ok(last > 1900 && last <= 2000, `driven by a picture of ${last - 1000} ms`);
    assert.ok(zero.at <= 2100, `zero came ${zero.at - 2000} ms after the picture was old`);
    const zeros = sent.slice(sent.indexOf(zero));
    assert.ok(zeros.length === 5 && zeros.every(({ forward }) => forward === 0));
  });
}

const press = () => teleop.hold("keyboard", FORWARD);
const watch = () => update(false, true);
const getControl = () => update(true, false);

function update(moves, observes) {
  [mayMove, watches] = [moves, observes];
  arming.update({ mayMove, watches, free: watches });
}

function seeFor(ms) {
  for (let left = ms; left > 0; left -= 50) {
    see();
    pass(50);
  }
}

// What was held does not drive on: nothing but zeros is sent after a time (0 for never), until it is pressed anew.
for (const [name, until, act] of [
  ["when the frame is back", 2000, () => [see(), press(), pass(1500), seeFor(1000)]],
  ["when it was pressed before the first frame", 0, () => [press(), pass(500), seeFor(600)]],
  ["when a person drives without video", 2000, () => [see(), press(), pass(1500), interlock.allow(), pass(500)]],
  [
    "when the link was lost meanwhile",
    1200,
    () => [see(), press(), pass(200), update(false, false), seeFor(500), getControl(), seeFor(600)],
  ],
  ["when the page watched meanwhile", 1200, () => [see(), press(), pass(200), watch(), seeFor(500), getControl(), seeFor(600)]],
  ["when it took the control while there was no frame", 0, () => [watch(), press(), getControl(), seeFor(600)]],
]) {
  test(`a key that is held drives no more ${name}`, () => {
    act();
    assert.ok(clock > 1500 && moving().every(({ at }) => at <= until));
    sent.length = 0;
    press();
    pass(50);
    assert.ok(moving().length > 0);
  });
}

test("no twist but zero goes out while driving is held", () => {
  for (const name of Object.keys(STILL)) arming.publish({ ...STILL, [name]: 0.1 }, clock);
  assert.deepEqual(sent, []);
});

test("a page that may not move sends nothing when the frame comes or goes, and asks for control where it watches", () => {
  update(false, false);
  see();
  press();
  pass(1500);
  assert.deepEqual([sent, takes], [[], 0]);
  watch();
  press();
  assert.deepEqual([sent, takes], [[], 1]);
});

test("what is under way on a link that is given up ends with a zero, and a page that only watches says nothing", () => {
  see();
  teleop.hold("keyboard", FORWARD);
  arming.leave();
  assert.deepEqual(sent.at(-1), { ...STILL, at: clock });
  sent.length = 0;
  watch();
  teleop.hold("keyboard", FORWARD);
  arming.leave();
  pass(200);
  assert.deepEqual(sent, []);
});

// How the kind changes by some steps; it is missing to begin with.
for (const [name, act, ...kinds] of [
  ["driving is held until the first frame", () => {}],
  ["a frame lets it go on", () => see(40), "seen"],
  ["a frame is good up to its time limit", () => [see(50), pass(950)], "seen"],
  ["a frame grows old by itself", () => [see(51), pass(950)], "seen", "old"],
  ["one that says it is of later is of now", () => [see(-5000), pass(1050)], "seen", "old"],
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
  ["so that none misses a change", () => [see(990), pass(20, false), see(5), pass(1050)], "seen", "old"],
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
