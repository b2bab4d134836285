import assert from "node:assert/strict";
import { beforeEach, describe, mock, test } from "node:test";

import { Driver } from "../../src/client/driver.js";
import { Teleop, mixed } from "../../src/client/teleop.js";

const FORWARD = { forward: 1, left: 0, turn: 0 };
const HALF = { forward: 0.5, left: 0, turn: 0 }; // what it becomes by the limits
const STILL = { forward: 0, left: 0, turn: 0 };
const ZEROS = Array(5).fill(STILL);

let clock, timestamp, sent, timestamps, wanted, drops, takes, output, teleop;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = timestamp = takes = 0;
  [sent, timestamps, wanted] = [[], [], []];
  output = { mayQueue: true, publish: (twist, at) => sent.push(twist) && timestamps.push(at) };
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

const hold = (input = "keyboard", value = FORWARD, ...more) => teleop.hold(input, value, ...more);
const release = (input = "keyboard") => teleop.release(input);
const forget = () => (sent.length = drops = 0);

test("holding sends at once and then at 20 Hz, in the limits' units", () => {
  hold("keyboard", { forward: 1, left: 0, turn: -1 });
  assert.deepEqual(sent, [{ forward: 0.5, left: 0, turn: -2 }]);
  pass(1000);
  assert.equal(sent.length, 21);
});

test("a change of a held input goes out with the next period, not faster", () => {
  for (let i = 0; i <= 10; i++) hold("joystick", { forward: i / 10, left: 0, turn: 0 });
  assert.equal(sent.length, 1);
  hold("joystick", HALF);
  pass(50);
  assert.deepEqual(sent.at(-1), { forward: 0.25, left: 0, turn: 0 });
});

test("two inputs add up to no more than the limit, and the last release stops", () => {
  hold();
  hold("joystick", { forward: 0.5, left: 0, turn: 0.25 });
  pass(50);
  assert.deepEqual(sent.at(-1), { forward: 0.5, left: 0, turn: 0.5 });
  forget();
  release();
  pass(50);
  assert.deepEqual(sent, [{ forward: 0.25, left: 0, turn: 0.5 }]);
  release("joystick");
  assert.deepEqual(sent.at(-1), STILL);
});

test("zero goes out whatever the rest of the page does", () => {
  const fail = () => {
    throw new Error("cannot draw");
  };
  hold();
  Object.assign(teleop.handlers, { onWanted: fail, onDrop: fail });
  forget();
  assert.throws(() => release(), /cannot draw/);
  assert.throws(() => teleop.halt(), /cannot draw/);
  assert.deepEqual(sent, [STILL, STILL]);
});

test("a page that nobody looks at is silent when nothing is held", () => {
  teleop.letGo();
  assert.deepEqual([sent, drops], [[], 1]);
});

// What is sent at once and in the 10 s after, how often the inputs were told to drop, by what ends a hold.
for (const [name, end, now, later, times] of [
  ["release sends zero at once, a few times, and then nothing", () => release(), [STILL], ZEROS, 0],
  ["halt zeroes at once and tells the inputs to drop what they hold", () => teleop.halt(), [STILL], ZEROS, 1],
  ["so does a page that nobody looks at", () => teleop.letGo(), [STILL], ZEROS, 1],
  ["a new link drops what the old one drove, even when no cut was reported", () => teleop.arm(true), [], [], 1],
  ["disarmed, it ends with zeros, and only a new press drives", () => [teleop.disarm(), hold()], [STILL], ZEROS, 1],
  ["disarmed, then armed again: what was held stays dropped", () => [teleop.disarm(), pass(500), teleop.arm(true)], ZEROS, ZEROS, 2],
  ["without a link nothing is sent, nor on the next one", () => [teleop.arm(false), hold(), teleop.arm(true)], [], [], 2],
  ["without a link nothing is sent, not even by halt", () => [teleop.arm(false), teleop.halt(), release()], [], [], 2],
  ["zeros that a freeze held back are not sent: somebody else may drive", () => [release(), forget(), freeze(10_000)], [], [], 1],
]) {
  test(name, () => {
    hold();
    forget();
    end();
    assert.deepEqual(sent, now);
    pass(10_000);
    assert.deepEqual([sent, drops], [later, times]);
    assert.deepEqual(wanted.at(-1), STILL);
  });
}

test("a hold drives again during the zeros of the last release, and after a disarm", () => {
  for (const end of [() => release(), () => [teleop.disarm(), teleop.arm(true)]]) {
    hold();
    end();
    hold();
    forget();
    pass(500);
    assert.deepEqual(sent, Array(10).fill(HALF));
  }
});

for (const [how, happen] of [
  ["the page froze", () => freeze(10_000)],
  ["a timer was late by more than 300 ms", () => freeze(340)],
  ["the machine slept, although the clock of events stood still", () => sleep(60_000)],
  ["the time of day was set back", () => sleep(-60_000)],
  ["the page froze and something else is pressed during the thaw", () => freeze(10_000) ?? hold("joystick")],
]) {
  test(`what was held does not drive on when ${how}`, () => {
    hold();
    pass(500);
    forget();
    happen();
    pass(1000);
    assert.deepEqual([sent, drops], [ZEROS, 1]);
  });
}

test("a busy page that is late by less than 300 ms drives on", () => {
  hold();
  freeze(290);
  pass(1000);
  assert.deepEqual(sent.at(-1), HALF);
});

// A poll says for how long its value holds.
const poll = () => hold("gamepad", FORWARD, timestamp, 200);

for (const [name, act, expected] of [
  ["a press has its event's, a hold that of its check", () => [hold("keyboard", FORWARD, 960), pass(100)], [960, 1050, 1100]],
  ["one that lies ahead, of a browser with another clock, is that of now", () => hold("keyboard", FORWARD, 1_700_000_000_000), [1000]],
  ["a late timer answers for when it should have run", () => [hold(), freeze(200), pass(50), pass(50)], [1000, 1050, 1300]],
  ["zero is meant whenever it is sent", () => [hold(), freeze(250), release()], [1000, 1250]],
  ["a poll has its own", () => [poll(), pass(40), poll(), pass(40), poll(), pass(40)], [1000, 1040, 1080]],
  ["what is polled no more grows older", () => [poll(), pass(200)], Array(5).fill(1000)],
  ["a key beside a polled input does not make it younger", () => [hold(), poll(), pass(100)], Array(3).fill(1000)],
]) {
  test(`the timestamp of a command: ${name}`, () => {
    timestamp = 1000;
    act();
    assert.deepEqual([timestamps, drops], [expected, 0]);
  });
}

test("what was polled is let go when nobody polls any more", () => {
  poll();
  pass(200);
  forget();
  pass(1000);
  assert.deepEqual([sent, drops], [ZEROS, 1]);
});

test("commands are left out while older ones wait in the browser, zero is not", () => {
  output.mayQueue = false;
  hold();
  pass(500);
  assert.deepEqual(sent, []);
  release();
  assert.deepEqual(sent, [STILL]);
});

test("a network that is stuck for longer than the robot's time limit needs a new press", () => {
  hold();
  output.mayQueue = false;
  pass(600);
  output.mayQueue = true;
  sent.length = 0;
  pass(1000);
  assert.ok(sent.every((twist) => twist.forward === 0));
  assert.equal(drops, 1);
});

test("a press on a page that watches asks for control and sends nothing", () => {
  teleop.watch();
  hold();
  pass(900);
  assert.equal(takes, 1);
  release();
  pass(200);
  assert.deepEqual(sent, []);
});

test("what took the control and is held still drives on from when it came, and not on the link after", () => {
  teleop.watch();
  hold();
  pass(900);
  teleop.arm(true);
  assert.deepEqual(sent, [HALF]);
  assert.ok(timestamps[0] <= timestamp);
  pass(100);
  assert.equal(sent.length, 3);
  teleop.arm(true);
  forget();
  pass(500);
  assert.deepEqual(sent, []);
});

for (const [end, act] of [
  ["the focus goes", () => teleop.letGo()],
  ["the link fails", () => teleop.arm(false)],
  ["driving is held, also if it is pressed meanwhile", () => [teleop.disarm(), hold()]],
  ["it is let go", () => release()],
  ["the page freezes", () => freeze(600)],
  ["control comes more than a second later", () => pass(1000)],
  ["a gamepad, which took it, is polled no more", () => [release(), hold("gamepad", FORWARD, timestamp, 250), pass(400)]],
]) {
  test(`what took the control moves nothing when ${end}, until it is pressed anew`, () => {
    teleop.watch();
    hold();
    pass(100);
    act();
    teleop.arm(true);
    pass(500);
    assert.deepEqual(sent, []);
    hold();
    assert.deepEqual(sent, [HALF]);
  });
}

const LIMITS = { linear: 0.5, angular: 2, turbo: { linear: 1, angular: 3 }, most: { linear: 1, angular: 3 } };
const input = (forward, left, turn, more = {}) => ({ forward, left, turn, ...more });

const TURBO = { turbo: true };

for (const [what, kind, inputs, expected] of [
  ["inputs add up to no more than the limit, and opposite ones cancel", "differential", [input(1, 0, 1), input(1, 0, -1)], HALF],
  ["no input is to stand still", "holonomic", [], STILL],
  ["only a robot that can goes sideways", "differential", [input(0, 1, 0)], STILL],
  ["a car does not", "ackermann", [input(0, 1, 0)], STILL],
  ["one that can does", "holonomic", [input(0, 1, 0)], { forward: 0, left: 0.5, turn: 0 }],
  ["the higher limits count while an input asks for them", "differential", [input(1, 0, 1, TURBO)], { forward: 1, left: 0, turn: 3 }],
  ["a car does not turn in place", "ackermann", [input(0, 0, 1)], STILL],
  ["it turns as it goes", "ackermann", [input(1, 0, 1)], { forward: 0.5, left: 0, turn: 1 }],
  ["and the other way as it backs", "ackermann", [input(-1, 0, 1)], { forward: -0.5, left: 0, turn: -1 }],
  ["up to the limit", "ackermann", [input(1, 0, 1, TURBO)], { forward: 1, left: 0, turn: 3 }],
]) {
  test(`mixed: ${what}`, () => assert.deepEqual(mixed(inputs, LIMITS, kind), expected));
}

test("without higher limits there is no turbo", () => {
  assert.equal(mixed([input(1, 0, 1, TURBO)], { linear: 0.5, angular: 2 }, "differential").forward, 0.5);
});

test("the limit holds for the speed along a diagonal too", () => {
  const { forward, left, turn } = mixed([input(1, -1, 1)], LIMITS, "holonomic");
  assert.ok(Math.abs(Math.hypot(forward, left) - 0.5) < 1e-9);
  assert.equal(left, -forward);
  assert.equal(turn, 2);
});

test("a car's curve is the stick's, whatever the speed", () => {
  const curve = ({ forward, turn }) => turn / forward;
  const fast = mixed([input(1, 0, 0.5)], LIMITS, "ackermann");
  const slow = mixed([input(0.2, 0, 0.5)], LIMITS, "ackermann");
  assert.ok(Math.abs(curve(fast) - curve(slow)) < 1e-9);
});

describe("a program", () => {
  let driver;

  beforeEach(() => {
    driver = new Driver({ output: { mayQueue: true, publish: (twist) => sent.push(twist) }, now: () => clock, timestamp: () => clock });
    driver.arm(true);
  });

  function repeat(ms, act) {
    for (let left = ms; left > 0; left -= 10) {
      pass(10);
      act();
    }
  }

  const countsNot = () => assert.equal(driver.drive({ forward: 0.5 }), false);
  const moved = () => sent.filter(({ forward }) => forward !== 0).length;

  test("a word goes out at once and then at 20 Hz while it is repeated, as it was said", () => {
    assert.equal(driver.drive({ forward: 0.5 }), true);
    assert.deepEqual(sent, [{ forward: 0.5, left: 0, turn: 0 }]);
    repeat(1000, () => driver.drive({ forward: 2.5, turn: -0.5 }));
    assert.equal(sent.length, 21);
    assert.deepEqual(sent.at(-1), { forward: 2.5, left: 0, turn: -0.5 });
  });

  test("a word that is not repeated within 0.3 s ends in zeros, and then in silence", () => {
    driver.drive({ forward: 0.5 });
    pass(300);
    assert.equal(moved(), sent.length);
    sent.length = 0;
    pass(2000);
    assert.deepEqual(sent, ZEROS);
  });

  test("zero stands still at once and then is silent", () => {
    driver.drive({ forward: 0.5 });
    forget();
    driver.drive(STILL);
    assert.deepEqual(sent, [STILL]);
    pass(1000);
    assert.deepEqual(sent, ZEROS);
  });

  for (const [end, act] of [
    ["silence", () => pass(1000)],
    ["a cut", () => [driver.arm(false), driver.drive({ forward: 0.5 }), driver.arm(true)]],
    ["a cut in which it began", () => [driver.drive(STILL), driver.arm(false), countsNot(), driver.arm(true)]],
    ["a stop", () => driver.halt()],
    ["a page that went out of sight", () => driver.letGo()],
  ]) {
    test(`after ${end} a program that goes on drives no more until it has said zero`, () => {
      driver.drive({ forward: 0.5 });
      act();
      sent.length = 0;
      countsNot();
      repeat(500, () => driver.drive({ forward: 0.5 }));
      assert.equal(moved(), 0);
      driver.drive(STILL);
      assert.equal(driver.drive({ forward: 0.5 }), true);
      assert.equal(moved(), 1);
    });
  }

  test("what is not a number throws and is not sent", () => {
    assert.throws(() => driver.drive({ forward: NaN }), /forward is NaN/);
    assert.throws(() => driver.drive({ turn: "1" }), TypeError);
    assert.throws(() => driver.drive({ forward: 1, trun: 1 }), /trun is none of forward, left and turn/);
    assert.deepEqual(sent, []);
  });
});
