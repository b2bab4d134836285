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

const countsNot = () => assert.equal(driver.drive({ forward: 0.5 }), false);
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

test("zero stands still at once and then is silent", () => {
  driver.drive({ forward: 0.5 });
  sent.length = 0;
  driver.drive(STILL);
  pass(1000);
  assert.deepEqual(sent, Array(5).fill(STILL));
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
    pass(500, () => driver.drive({ forward: 0.5 }));
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
