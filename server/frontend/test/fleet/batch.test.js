import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { Batch, Seldom } from "../../src/fleet/list.js";

let clock;

beforeEach(() => {
  mock.timers.enable({ apis: ["setTimeout"] });
  clock = 10_000;
});

afterEach(() => mock.timers.reset());

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
  frames.shift()();
  assert.deepEqual(applied, [["a", "b"], ["a"]]);
});

test("what was applied early leaves its frame nothing to do, and later changes get one", () => {
  const frames = [];
  const applied = [];
  const batch = new Batch({ apply: (names) => applied.push([...names]), frame: (act) => frames.push(act) });
  batch.add("a");
  batch.flush();
  batch.add("b");
  for (const frame of frames) frame();
  assert.deepEqual(applied, [["a"], ["b"]]);
});

test("what is costly is done at once, and then seldom, but never left undone", () => {
  let acts = 0;
  const seldom = new Seldom({ act: () => (acts += 1), everyMs: 1000, now: () => clock });
  const pass = (ms) => {
    clock += ms;
    mock.timers.tick(ms);
  };
  seldom.ask();
  assert.equal(acts, 1);
  for (let i = 0; i < 9; i++) {
    seldom.ask();
    pass(100);
  }
  assert.equal(acts, 1);
  pass(100);
  assert.equal(acts, 2);
  pass(5000);
  assert.equal(acts, 2);
});
