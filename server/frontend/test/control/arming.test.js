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
  test(`a key that is held while the picture grows old ends in zeros within 100 ms, ${checks ? "by" : "without"} the page's timer`, () => {
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

test("when the picture is back, what was held drives only after it was pressed anew", () => {
  see();
  teleop.hold("keyboard", FORWARD);
  pass(1500);
  sent.length = 0;
  for (let i = 0; i < 20; i++) {
    see();
    pass(50);
  }
  assert.deepEqual(sent, []);
  teleop.hold("keyboard", FORWARD);
  assert.equal(moving().length, 1);
});

test("a key that was pressed while driving was held does not count when it ends", () => {
  teleop.hold("keyboard", FORWARD);
  pass(500);
  assert.deepEqual(sent, []);
  see();
  pass(500);
  assert.deepEqual(moving(), []);
});

test("a person who drives without the picture needs a new press, too", () => {
  see();
  teleop.hold("keyboard", FORWARD);
  pass(1500);
  sent.length = 0;
  interlock.allow();
  pass(500);
  assert.deepEqual(sent, []);
  teleop.hold("keyboard", FORWARD);
  pass(500);
  assert.equal(moving().at(-1).at, clock);
});

test("a page that may not move sends nothing at all when the picture comes or goes", () => {
  mayMove = false;
  arming.update({ mayMove, watches, free: watches });
  see();
  teleop.hold("keyboard", FORWARD);
  pass(1500);
  assert.deepEqual(sent, []);
});

function watch() {
  mayMove = false;
  watches = true;
  arming.update({ mayMove, watches, free: watches });
}

function getControl() {
  mayMove = true;
  watches = false;
  arming.update({ mayMove, watches, free: watches });
}

test("a key that took the control moves nothing while there is no picture, nor when it comes", () => {
  watch();
  teleop.hold("keyboard", FORWARD);
  assert.equal(takes, 1);
  getControl();
  see();
  pass(500);
  assert.deepEqual(moving(), []);
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
