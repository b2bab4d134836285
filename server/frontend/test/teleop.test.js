import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Teleop } from "../src/teleop.js";

const FORWARD = { forward: 1, turn: 0 };
const STILL = { forward: 0, turn: 0 };

let sent, wanted, drops, mayQueue, teleop;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  sent = [];
  wanted = [];
  drops = 0;
  mayQueue = true;
  teleop = new Teleop({
    publish: (twist) => sent.push(twist),
    limits: { linear: 0.5, angular: 2 },
    mayQueue: () => mayQueue,
    onDrop: () => (drops += 1),
    onWanted: (twist) => wanted.push(twist),
  });
  teleop.arm(true);
});

test("holding sends at once and then at 20 Hz, in the limits' units", () => {
  teleop.hold("keyboard", { forward: 1, turn: -1 });
  assert.deepEqual(sent, [{ forward: 0.5, turn: -2 }]);
  mock.timers.tick(1000);
  assert.equal(sent.length, 21);
});

test("a change of a held input goes out with the next period, not faster", () => {
  teleop.hold("joystick", FORWARD);
  for (let i = 1; i <= 10; i++) teleop.hold("joystick", { forward: i / 10, turn: 0 });
  assert.equal(sent.length, 1);
  teleop.hold("joystick", { forward: 0.5, turn: 0 });
  mock.timers.tick(50);
  assert.deepEqual(sent.at(-1), { forward: 0.25, turn: 0 });
});

test("release sends zero at once, a few times, and then nothing", () => {
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  teleop.release("keyboard");
  assert.deepEqual(sent, [STILL]);
  mock.timers.tick(10_000);
  assert.deepEqual(sent, Array(5).fill(STILL));
});

test("two inputs add up to no more than the limit, and the last release stops", () => {
  teleop.hold("keyboard", FORWARD);
  teleop.hold("joystick", { forward: 0.5, turn: 0.25 });
  mock.timers.tick(50);
  assert.deepEqual(sent.at(-1), { forward: 0.5, turn: 0.5 });
  teleop.release("keyboard");
  mock.timers.tick(50);
  assert.deepEqual(sent.at(-1), { forward: 0.25, turn: 0.5 });
  teleop.release("joystick");
  assert.deepEqual(sent.at(-1), STILL);
});

test("halt zeroes at once, drops what is held, and tells the inputs", () => {
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  teleop.halt();
  assert.deepEqual(sent, [STILL]);
  assert.equal(drops, 1);
  mock.timers.tick(10_000);
  assert.deepEqual(sent, Array(5).fill(STILL));
});

test("a page that nobody looks at zeroes what is held, and is silent when nothing is", () => {
  teleop.letGo();
  assert.deepEqual(sent, []);
  teleop.hold("joystick", FORWARD);
  teleop.letGo();
  assert.deepEqual(sent.at(-1), STILL);
  assert.equal(drops, 1);
});

test("a hold during the zeros of the last release drives again", () => {
  teleop.hold("keyboard", FORWARD);
  teleop.release("keyboard");
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  mock.timers.tick(500);
  assert.deepEqual(sent, Array(10).fill({ forward: 0.5, turn: 0 }));
});

test("disarming stops sending, and what was held before stays dropped when armed again", () => {
  teleop.hold("keyboard", FORWARD);
  sent.length = 0;
  teleop.arm(false);
  teleop.hold("keyboard", FORWARD);
  teleop.arm(true);
  mock.timers.tick(10_000);
  assert.deepEqual(sent, []);
  assert.equal(drops, 1);
  assert.deepEqual(wanted.at(-1), STILL);
});

test("nothing is sent while disarmed, not even by halt", () => {
  teleop.arm(false);
  teleop.halt();
  teleop.release("keyboard");
  mock.timers.tick(1000);
  assert.deepEqual(sent, []);
});

test("commands are left out while older ones wait in the browser, zero is not", () => {
  mayQueue = false;
  teleop.hold("keyboard", FORWARD);
  mock.timers.tick(500);
  assert.deepEqual(sent, []);
  teleop.release("keyboard");
  assert.deepEqual(sent, [STILL]);
});

test("a limit that changes while driving counts from the next command on", () => {
  teleop.hold("keyboard", FORWARD);
  teleop.limits.linear = 0.1;
  mock.timers.tick(50);
  assert.deepEqual(sent.at(-1), { forward: 0.1, turn: 0 });
});
