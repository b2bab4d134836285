import assert from "node:assert/strict";
import { test } from "node:test";

import { LoginUse, ServerClock } from "../../src/dom/calls.js";

const NOW = Date.parse("2026-01-01T12:00:00Z");
const at = (ms) => new Date(NOW + ms).toISOString();

test("seconds are counted up to whole ones, and end at 0", () => {
  const clock = new ServerClock(() => NOW);
  assert.equal(clock.secondsUntil(at(20_000)), 20);
  assert.equal(clock.secondsUntil(at(19_001)), 20);
  assert.equal(clock.secondsUntil(at(-5000)), 0);
  assert.equal(clock.secondsUntil("soon"), 0);
});

test("a machine whose clock is wrong counts as the server does", () => {
  let now = NOW + 3_600_000;
  const clock = new ServerClock(() => now);
  clock.receive(new Date(NOW).toUTCString());
  assert.equal(clock.secondsUntil(at(20_000)), 20);
  now += 10_000;
  assert.equal(clock.secondsUntil(at(20_000)), 10);
});

const MINUTE = 60_000;

function make() {
  const made = { clock: 1000, asked: 0, answer: Promise.resolve() };
  made.use = new LoginUse({ ask: () => (made.asked++, made.answer), now: () => made.clock });
  return made;
}

test("a page that is used asks once in five minutes, and one that nobody touches never", () => {
  const made = make();
  const page = new EventTarget();
  made.use.watch(page);
  page.dispatchEvent(new Event("keydown"));
  assert.equal(made.asked, 0, "the page has just been loaded");
  for (const [count, name] of ["pointerdown", "keydown", "wheel"].entries()) {
    made.clock += 5 * MINUTE;
    page.dispatchEvent(new Event("pointermove"));
    assert.equal(made.asked, count);
    for (let i = 0; i < 3; i++) page.dispatchEvent(new Event(name));
    assert.equal(made.asked, count + 1);
  }
});

test("a network that is cut disturbs nothing", async () => {
  const made = make();
  made.answer = Promise.reject(new TypeError("network"));
  made.clock += 5 * MINUTE;
  made.use.note();
  await new Promise(setImmediate);
  assert.equal(made.asked, 1);
});
