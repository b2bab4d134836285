import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Batch, PointerPause, throttled } from "../../src/fleet/list.js";

test("what changes within a frame is applied once", () => {
  const frames = [];
  const applied = [];
  const batch = new Batch({ apply: (names) => applied.push([...names]), frame: (act) => frames.push(act) });
  for (const name of ["a", "b", "a"]) batch.add(name);
  assert.equal(frames.length, 1);
  assert.deepEqual(applied, []);
  frames.shift()();
  assert.deepEqual(applied, [["a", "b"]]);
  batch.add("a");
  batch.flush();
  batch.add("b");
  for (const frame of frames) frame();
  assert.deepEqual(applied, [["a", "b"], ["a"], ["b"]], "what was applied early leaves its frame nothing to do");
});

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

test("so does the keyboard's focus", () => {
  focused = {};
  assert.equal(pause.active, true);
  focused = null;
  say("focusout");
  pass(0);
  assert.equal(rests, 1);
});
