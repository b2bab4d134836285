import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { MovingHand, heirs, keyOfPress, keysFor, requestsByRobot, wallNames } from "../../src/fleet/wall.js";

const robot = (name, online = true) => ({ name, online });
const asks = (name, more = {}) => ({ robot: name, reason: "stuck", source: "page", age_s: 125, priority: 2, state: "waiting", ...more });

test("robots that ask for help stand first, as their requests come, then those online, as many as a person watches", () => {
  const robots = [robot("a", false), ...Array.from({ length: 30 }, (_, place) => robot(`r${place}`)), robot("z", false)];
  const byRobot = requestsByRobot([asks("z"), asks("r29"), asks("z"), asks("not-seen")]);
  const names = wallNames(robots, byRobot, 8);
  assert.equal(names.length, 8);
  assert.deepEqual(names.slice(0, 4), ["z", "r29", "r0", "r1"]);
  assert.deepEqual(wallNames([robot("a", false), robot("b")], new Map()), ["b", "a"]);
});

test("a robot keeps its key wherever it moves, and one that comes gets one that is free", () => {
  const before = keysFor(["a", "b", "c"]);
  assert.deepEqual(Object.fromEntries(before), { a: "1", b: "2", c: "3" });
  const after = keysFor(["d", "c", "a"], before);
  assert.deepEqual(Object.fromEntries(after), { a: "1", c: "3", d: "2" });
});

test("a robot that comes to another's place, or gets its key, is an heir", () => {
  const before = { names: ["a", "b"], keys: keysFor(["a", "b"]) };
  const names = ["c", "a", "d"];
  assert.deepEqual(heirs(names, keysFor(names, before.keys), before), { places: ["c", "a"], keys: ["c"] });
  assert.deepEqual(heirs(names, keysFor(names), { names: [], keys: new Map() }), { places: [], keys: [] });
});

for (const [press, key] of [
  [{ key: "3", code: "Digit3" }, "3"],
  [{ key: '"', code: "Digit3" }, "3"], // a French keyboard
  [{ key: "0", code: "Numpad0" }, "0"],
  [{ key: "Q", code: "KeyQ" }, "q"],
  [{ key: "z", code: "KeyZ" }, ""],
  [{ key: "Enter", code: "Enter" }, ""],
  [{ key: "3", code: "Digit3", ctrlKey: true }, ""],
  [{ key: "3", code: "Digit3", repeat: true }, ""],
]) {
  test(`the press ${JSON.stringify(press)} takes the robot of the key ${key || "none"}`, () => assert.equal(keyOfPress(press), key));
}

test("a hand that moves keeps the robots where they are, and one that rests does not", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  let now = 0;
  const onRest = mock.fn();
  const hand = new MovingHand({ onRest, now: () => now });
  const wall = new EventTarget();
  hand.listen(wall);
  assert.equal(hand.moves, false);
  wall.dispatchEvent(new Event("pointermove"));
  assert.equal(hand.moves, true);
  now = 3000;
  t.mock.timers.tick(3000);
  assert.deepEqual([hand.moves, onRest.mock.callCount()], [false, 1]);
});
