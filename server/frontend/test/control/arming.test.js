import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Teleop } from "../../src/client/teleop.js";
import { Arming, VideoInterlock } from "../../src/control/arming.js";

const FORWARD = { forward: 1, left: 0, turn: 0 };
const STILL = { forward: 0, left: 0, turn: 0 };
const CHECK_MS = 50;

let clock, sent, mayMove, watches, takes, teleop, interlock, arming;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = 1000;
  sent = [];
  mayMove = true;
  watches = false;
  takes = 0;
  interlock = new VideoInterlock({
    afterMs: 1000,
    onChange: () => arming.update({ mayMove, watches, free: watches }),
    now: () => clock,
    wall: () => clock,
  });
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
});

// With the page's own timer for the check, or without, as if that were late.
function pass(ms, checks = true) {
  for (let left = ms; left > 0; left -= 10) {
    clock += 10;
    mock.timers.tick(10);
    if (checks && clock % CHECK_MS === 0) interlock.check();
  }
}

const see = (ageMs = 0) => interlock.receive({ offered: true, at: clock - ageMs });
const moving = () => sent.filter(({ forward }) => forward !== 0);

for (const checks of [true, false]) {
  test(`a key that is held while the frame grows old ends in zeros within 100 ms, ${checks ? "by" : "without"} the page's timer`, () => {
    see();
    teleop.hold("keyboard", FORWARD);
    pass(2000, checks);
    const last = moving().at(-1).at;
    const zero = sent.find(({ forward }) => forward === 0);
    assert.ok(last <= 2000, `driven by a picture of ${last - 1000} ms`);
    assert.ok(zero.at <= 2100, `zero came ${zero.at - 2000} ms after the picture was old`);
    assert.deepEqual(
      sent.slice(sent.indexOf(zero)).map(({ forward }) => forward),
      [0, 0, 0, 0, 0],
    );
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

test("a page that may not move sends nothing at all when the frame comes or goes", () => {
  update(false, false);
  see();
  press();
  pass(1500);
  assert.deepEqual([sent, takes], [[], 0]);
});

test("a press on a page that watches asks for control", () => {
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
