import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { PointerPause, throttled } from "../../src/fleet/list.js";

test("what is costly is done at once, and then seldom, but never left undone", () => {
  let acts = 0;
  const seldom = throttled(
    () => (acts += 1),
    1000,
    () => clock,
  );
  seldom();
  assert.equal(acts, 1);
  for (let i = 0; i < 9; i++) {
    seldom();
    pass(100);
  }
  assert.equal(acts, 1);
  pass(100);
  assert.equal(acts, 2);
  pass(5000);
  assert.equal(acts, 2);
});

let clock, rests, list, focused, pause;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  clock = 10_000;
  rests = 0;
  focused = null;
  list = Object.assign(new EventTarget(), { querySelector: () => focused });
  pause = new PointerPause({ onEnd: () => (rests += 1), now: () => clock });
  pause.listen(list);
});

const say = (name, more = {}) => list.dispatchEvent(Object.assign(new Event(name), more));

function pass(ms) {
  clock += ms;
  mock.timers.tick(ms);
}

test("a finger disturbs it for some seconds after it has touched", () => {
  say("pointerover", { pointerType: "touch" });
  say("pointerdown", { pointerType: "touch" });
  assert.equal(pause.active, true);
  pass(2999);
  assert.equal(pause.active, true);
  const before = rests;
  pass(1);
  assert.equal(pause.active, false);
  assert.equal(rests, before + 1);
});
