import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { PointerPause } from "../../src/fleet/list.js";

let clock, rests, list, focused, pause;

beforeEach(() => {
  mock.timers.enable({ apis: ["setTimeout"] });
  clock = 10_000;
  rests = 0;
  focused = null;
  list = Object.assign(new EventTarget(), { querySelector: () => focused });
  pause = new PointerPause({ onEnd: () => (rests += 1), now: () => clock });
  pause.listen(list);
});

afterEach(() => mock.timers.reset());

const say = (name, more = {}) => list.dispatchEvent(Object.assign(new Event(name), more));

function pass(ms) {
  clock += ms;
  mock.timers.tick(ms);
}

test("a list is disturbed as long as a mouse is over it", () => {
  assert.equal(pause.active, false);
  say("pointerover", { pointerType: "mouse" });
  pass(60_000);
  assert.equal(pause.active, true);
  say("pointerleave");
  assert.equal(pause.active, false);
  assert.equal(rests, 1);
});

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

test("so does the keyboard's focus", () => {
  focused = {};
  assert.equal(pause.active, true);
  focused = null;
  say("focusout");
  pass(0);
  assert.equal(rests, 1);
});
