import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { mixed, Teleop } from "../../src/client/teleop.js";

const FORWARD = { forward: 1, left: 0, turn: 0 };
const STILL = { forward: 0, left: 0, turn: 0 };

let clock, timestamp, sent, moments, wanted, drops, takes, output, teleop;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = timestamp = 0;
  sent = [];
  moments = [];
  wanted = [];
  drops = takes = 0;
  output = { mayQueue: true, publish: (twist, at) => sent.push(twist) && moments.push(at) };
  teleop = new Teleop({
    output,
    limits: { linear: 0.5, angular: 2 },
    onDrop: () => (drops += 1),
    onTake: () => (takes += 1),
    onWanted: (twist) => wanted.push(twist),
    now: () => clock,
    timestamp: () => timestamp,
  });
  teleop.arm(true);
  drops = 0;
});

function pass(ms) {
  for (const end = clock + ms; clock < end;) {
    clock += 10;
    timestamp += 10;
    mock.timers.tick(10);
  }
}

// What a frozen tab, a sleeping machine or an open dialog does: time passes and no timer runs.
function freeze(ms) {
  clock += ms;
  timestamp += ms;
}

// A sleep of the machine, in which the clock of events stands still.
function sleep(ms) {
  clock += ms;
}

test("holding sends at once and then at 20 Hz, in the limits' units", () => {
  teleop.hold("keyboard", { forward: 1, left: 0, turn: -1 });
  assert.deepEqual(sent, [{ forward: 0.5, left: 0, turn: -2 }]);
  pass(1000);
  assert.equal(sent.length, 21);
});

test("a change of a held input goes out with the next period, not faster", () => {
  teleop.hold("joystick", FORWARD);
  for (let i = 1; i <= 10; i++) teleop.hold("joystick", { forward: i / 10, left: 0, turn: 0 });
  assert.equal(sent.length, 1);
  teleop.hold("joystick", { forward: 0.5, left: 0, turn: 0 });
  pass(50);
  assert.deepEqual(sent.at(-1), { forward: 0.25, left: 0, turn: 0 });
});

test("release sends zero at once, a few times, and then nothing", () => {
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  teleop.release("keyboard");
  assert.deepEqual(sent, [STILL]);
  pass(10_000);
  assert.deepEqual(sent, Array(5).fill(STILL));
});

test("two inputs add up to no more than the limit, and the last release stops", () => {
  teleop.hold("keyboard", FORWARD);
  teleop.hold("joystick", { forward: 0.5, left: 0, turn: 0.25 });
  pass(50);
  assert.deepEqual(sent.at(-1), { forward: 0.5, left: 0, turn: 0.5 });
  teleop.release("keyboard");
  pass(50);
  assert.deepEqual(sent.at(-1), { forward: 0.25, left: 0, turn: 0.5 });
  teleop.release("joystick");
  assert.deepEqual(sent.at(-1), STILL);
});

test("halt zeroes at once, drops what is held, and tells the inputs", () => {
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  teleop.halt();
  assert.deepEqual(sent, [STILL]);
  assert.equal(drops, 1);
  pass(10_000);
  assert.deepEqual(sent, Array(5).fill(STILL));
});

test("zero goes out whatever the rest of the page does", () => {
  const fail = () => {
    throw new Error("cannot draw");
  };
  teleop.hold("keyboard", FORWARD);
  Object.assign(teleop.handlers, { onWanted: fail, onDrop: fail });
  sent.length = 0;
  assert.throws(() => teleop.release("keyboard"), /cannot draw/);
  assert.throws(() => teleop.halt(), /cannot draw/);
  assert.deepEqual(sent, [STILL, STILL]);
});

test("a page that nobody looks at zeroes what is held, and is silent when nothing is", () => {
  teleop.letGo();
  assert.deepEqual(sent, []);
  assert.equal(drops, 1);
  teleop.hold("joystick", FORWARD);
  teleop.letGo();
  assert.deepEqual(sent.at(-1), STILL);
  assert.equal(drops, 2);
});

test("a hold during the zeros of the last release drives again", () => {
  teleop.hold("keyboard", FORWARD);
  teleop.release("keyboard");
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  pass(500);
  assert.deepEqual(sent, Array(10).fill({ forward: 0.5, left: 0, turn: 0 }));
});

test("disarming stops sending, and what was held before stays dropped when armed again", () => {
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  teleop.arm(false);
  assert.equal(drops, 1);
  teleop.hold("keyboard", FORWARD);
  teleop.arm(true);
  assert.equal(drops, 2);
  pass(10_000);
  assert.deepEqual(sent, []);
  assert.deepEqual(wanted.at(-1), STILL);
});

test("a new link drops what the old one drove, even when nothing told of a cut", () => {
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  teleop.arm(true);
  pass(10_000);
  assert.deepEqual(sent, []);
  assert.equal(drops, 1);
});

for (const [how, happen] of [
  ["the page froze", () => freeze(10_000)],
  ["a timer was late by more than 300 ms", () => freeze(340)],
  ["the machine slept, although the clock of events stood still", () => sleep(60_000)],
  ["the page froze and something else is pressed during the thaw", () => freeze(10_000) ?? teleop.hold("joystick", FORWARD)],
]) {
  test(`what was held does not drive on when ${how}`, () => {
    teleop.hold("keyboard", FORWARD);
    pass(500);
    sent.length = drops = 0;
    happen();
    pass(1000);
    assert.deepEqual(sent, Array(5).fill(STILL));
    assert.equal(drops, 1);
  });
}

test("zeros that a freeze held back are not sent after it, since somebody else may drive", () => {
  teleop.hold("keyboard", FORWARD);
  teleop.release("keyboard");
  sent.length = 0;
  freeze(10_000);
  pass(1000);
  assert.deepEqual(sent, []);
});

test("a busy page that is late by less than 300 ms drives on", () => {
  teleop.hold("keyboard", FORWARD);
  freeze(290);
  pass(1000);
  assert.deepEqual(sent.at(-1), { forward: 0.5, left: 0, turn: 0 });
});

test("a press has the moment of its event, and what is held the moment at which that was seen", () => {
  timestamp = 1000;
  teleop.hold("keyboard", FORWARD, 960);
  pass(100);
  assert.deepEqual(moments, [960, 1050, 1100]);
});

test("a moment that lies ahead, of a browser with another clock, is that of now", () => {
  timestamp = 1000;
  teleop.hold("keyboard", FORWARD, 1_700_000_000_000);
  assert.deepEqual(moments, [1000]);
});

test("a late timer answers for the time at which it should have run, not for later", () => {
  teleop.hold("keyboard", FORWARD, 0);
  freeze(200);
  pass(50);
  assert.deepEqual(moments, [0, 50]);
  pass(50);
  assert.equal(moments.at(-1), 300);
});

test("zero is meant whenever it is sent", () => {
  teleop.hold("keyboard", FORWARD, 0);
  freeze(250);
  teleop.release("keyboard");
  assert.equal(moments.at(-1), 250);
});

test("nothing is sent while disarmed, not even by halt: somebody else may drive", () => {
  teleop.disarm();
  pass(100);
  teleop.arm(false);
  teleop.halt();
  teleop.release("keyboard");
  pass(1000);
  assert.deepEqual(sent, []);
});

test("commands are left out while older ones wait in the browser, zero is not", () => {
  output.mayQueue = false;
  teleop.hold("keyboard", FORWARD);
  pass(500);
  assert.deepEqual(sent, []);
  teleop.release("keyboard");
  assert.deepEqual(sent, [STILL]);
});

test("a network that is stuck for longer than the robot's patience needs a new press", () => {
  teleop.hold("keyboard", FORWARD);
  output.mayQueue = false;
  pass(600);
  output.mayQueue = true;
  sent.length = 0;
  pass(1000);
  assert.ok(sent.every((twist) => twist.forward === 0));
  assert.equal(drops, 1);
});

test("a limit that changes while driving counts from the next command on", () => {
  teleop.hold("keyboard", FORWARD);
  teleop.limits.linear = 0.1;
  pass(50);
  assert.deepEqual(sent.at(-1), { forward: 0.1, left: 0, turn: 0 });
});

test("a polled input drives for as long as it is polled, each time with the poll's moment", () => {
  teleop.hold("gamepad", FORWARD, 0, 200);
  for (let i = 0; i < 4; i++) {
    pass(40);
    teleop.hold("gamepad", FORWARD, timestamp, 200);
  }
  assert.deepEqual(moments, [0, 40, 80, 120]);
  assert.equal(drops, 0);
});

test("what was polled is let go when nobody polls any more, and until then it grows older", () => {
  teleop.hold("gamepad", FORWARD, 0, 200);
  pass(200);
  assert.deepEqual(moments, [0, 0, 0, 0, 0]);
  sent.length = 0;
  pass(1000);
  assert.deepEqual(sent, Array(5).fill(STILL));
  assert.equal(drops, 1);
});

test("a key that is held beside a polled input does not make it younger", () => {
  teleop.hold("keyboard", FORWARD, 0);
  teleop.hold("gamepad", FORWARD, 0, 200);
  pass(100);
  assert.deepEqual(moments, [0, 0, 0]);
});

test("where a person may not drive on, zeros end what is under way, and only a new press drives", () => {
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  teleop.disarm();
  teleop.hold("keyboard", FORWARD);
  pass(1000);
  assert.deepEqual(sent, Array(5).fill(STILL));
  assert.equal(drops, 1);
  teleop.arm(true);
  pass(1000);
  assert.equal(sent.length, 5);
  teleop.hold("keyboard", FORWARD);
  assert.equal(sent.at(-1).forward, 0.5);
});

test("a press on a page that watches asks for control and sends nothing", () => {
  teleop.watch();
  teleop.hold("keyboard", FORWARD);
  pass(900);
  assert.equal(takes, 1);
  teleop.release("keyboard");
  pass(200);
  assert.deepEqual(sent, []);
});

test("what took the control and is held still drives on from the moment at which it came", () => {
  teleop.watch();
  teleop.hold("keyboard", FORWARD);
  pass(300);
  teleop.arm(true);
  assert.deepEqual(sent, [{ forward: 0.5, left: 0, turn: 0 }]);
  assert.ok(moments[0] <= timestamp);
  pass(100);
  assert.equal(sent.length, 3);
  teleop.release("keyboard");
  assert.deepEqual(sent.at(-1), STILL);
});

test("control that comes more than a second after the press moves nothing until it is pressed anew", () => {
  teleop.watch();
  teleop.hold("keyboard", FORWARD);
  pass(1100);
  assert.ok(drops > 0);
  teleop.arm(true);
  pass(500);
  assert.deepEqual(sent, []);
  teleop.hold("keyboard", FORWARD);
  assert.equal(sent.length, 1);
});

// prettier-ignore
for (const [end, act] of [["the focus goes", () => teleop.letGo()], ["the link fails", () => teleop.arm(false)], ["driving is held", () => teleop.disarm()], ["it is let go", () => teleop.release("keyboard")], ["the page freezes", () => freeze(600)]]) {
  test(`what took the control moves nothing when ${end} meanwhile`, () => {
    teleop.watch();
    teleop.hold("keyboard", FORWARD);
    pass(100);
    act();
    teleop.arm(true);
    pass(500);
    assert.deepEqual(sent, []);
  });
}

test("a gamepad that is no longer looked at takes the control and moves nothing", () => {
  teleop.watch();
  teleop.hold("gamepad", FORWARD, timestamp, 250);
  pass(400);
  teleop.arm(true);
  pass(500);
  assert.equal(takes, 1);
  assert.deepEqual(sent, []);
});

const LIMITS = { linear: 0.5, angular: 2, turbo: { linear: 1, angular: 3 }, most: { linear: 1, angular: 3 } };
const input = (forward, left, turn, more = {}) => ({ forward, left, turn, ...more });

test("inputs add up to no more than the limit, and opposite ones cancel", () => {
  const both = [input(1, 0, 1), input(1, 0, -1)];
  assert.deepEqual(mixed(both, LIMITS, "differential"), { forward: 0.5, left: 0, turn: 0 });
  assert.deepEqual(mixed([], LIMITS, "holonomic"), { forward: 0, left: 0, turn: 0 });
});

test("only a robot that can go sideways is told to", () => {
  assert.equal(mixed([input(0, 1, 0)], LIMITS, "differential").left, 0);
  assert.equal(mixed([input(0, 1, 0)], LIMITS, "ackermann").left, 0);
  assert.equal(mixed([input(0, 1, 0)], LIMITS, "holonomic").left, 0.5);
});

test("the limit holds for the speed along a diagonal too", () => {
  const { forward, left, turn } = mixed([input(1, -1, 1)], LIMITS, "holonomic");
  assert.ok(Math.abs(Math.hypot(forward, left) - 0.5) < 1e-9);
  assert.equal(left, -forward);
  assert.equal(turn, 2);
});

test("the higher limits count for as long as an input asks for them", () => {
  const pad = [input(1, 0, 1, { turbo: true })];
  assert.deepEqual(mixed(pad, LIMITS, "differential"), { forward: 1, left: 0, turn: 3 });
  assert.equal(mixed(pad, { linear: 0.5, angular: 2 }, "differential").forward, 0.5);
});

test("a car does not turn in place, and turns the other way as it backs", () => {
  assert.deepEqual(mixed([input(0, 0, 1)], LIMITS, "ackermann"), { forward: 0, left: 0, turn: 0 });
  assert.equal(mixed([input(1, 0, 1)], LIMITS, "ackermann").turn, 1);
  assert.equal(mixed([input(-1, 0, 1)], LIMITS, "ackermann").turn, -1);
});

test("a car's curve is the stick's, whatever the speed, and its turn stays within the limit", () => {
  const curve = ({ forward, turn }) => turn / forward;
  const fast = mixed([input(1, 0, 0.5)], LIMITS, "ackermann");
  const slow = mixed([input(0.2, 0, 0.5)], LIMITS, "ackermann");
  assert.ok(Math.abs(curve(fast) - curve(slow)) < 1e-9);
  assert.equal(mixed([input(1, 0, 1, { turbo: true })], LIMITS, "ackermann").turn, 3);
});
