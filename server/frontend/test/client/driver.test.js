import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Driver } from "../../src/client/driver.js";

const STILL = { forward: 0, left: 0, turn: 0 };

let clock, sent, driver;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = 1000;
  sent = [];
  driver = new Driver({ output: { mayQueue: true, publish: (twist) => sent.push(twist) }, now: () => clock, timestamp: () => clock });
  driver.arm(true);
});

function pass(ms, act = () => {}) {
  for (let left = ms; left > 0; left -= 10) {
    clock += 10;
    mock.timers.tick(10);
    act();
  }
}

const moved = () => sent.filter(({ forward }) => forward !== 0).length;

test("a word goes out at once and then at 20 Hz while it is repeated, as it was said", () => {
  assert.equal(driver.drive({ forward: 0.5 }), true);
  assert.deepEqual(sent, [{ forward: 0.5, left: 0, turn: 0 }]);
  pass(1000, () => driver.drive({ forward: 2.5, turn: -0.5 }));
  assert.equal(sent.length, 21);
  assert.deepEqual(sent.at(-1), { forward: 2.5, left: 0, turn: -0.5 });
});

test("a word that is not repeated within 0.3 s ends in zeros, and then in silence", () => {
  driver.drive({ forward: 0.5 });
  pass(300);
  assert.equal(moved(), sent.length);
  sent.length = 0;
  pass(2000);
  assert.deepEqual(sent, Array(5).fill(STILL));
});

test("after that it drives no more until its program has said zero", () => {
  driver.drive({ forward: 0.5 });
  pass(1000);
  sent.length = 0;
  assert.equal(driver.drive({ forward: 0.5 }), false);
  pass(500, () => driver.drive({ forward: 0.5 }));
  assert.deepEqual(sent, []);
  driver.drive(STILL);
  assert.equal(driver.drive({ forward: 0.5 }), true);
  assert.equal(moved(), 1);
});

test("zero stands still at once and then is silent", () => {
  driver.drive({ forward: 0.5 });
  sent.length = 0;
  driver.drive(STILL);
  pass(1000);
  assert.deepEqual(sent, Array(5).fill(STILL));
});

test("a program that goes on through a cut does not drive on the new link", () => {
  driver.drive({ forward: 0.5 });
  driver.arm(false);
  assert.equal(driver.drive({ forward: 0.5 }), false);
  driver.arm(true);
  sent.length = 0;
  pass(500, () => driver.drive({ forward: 0.5 }));
  assert.deepEqual(sent, []);
  driver.drive({});
  assert.equal(driver.drive({ forward: 0.5 }), true);
});

test("a stop halts, and what goes on after it does not count", () => {
  driver.drive({ forward: 0.5 });
  driver.halt();
  sent.length = 0;
  pass(500, () => driver.drive({ forward: 0.5 }));
  assert.equal(moved(), 0);
});

test("what is not a number throws and is not sent", () => {
  assert.throws(() => driver.drive({ forward: NaN }), /forward is NaN/);
  assert.throws(() => driver.drive({ turn: "1" }), TypeError);
  assert.throws(() => driver.drive({ forward: 1, trun: 1 }), /trun is none of forward, left and turn/);
  assert.deepEqual(sent, []);
});
