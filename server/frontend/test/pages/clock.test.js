import assert from "node:assert/strict";
import { test } from "node:test";

import { ServerClock } from "../../src/pages/calls.js";

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

test("an answer without a time changes nothing", () => {
  const clock = new ServerClock(() => NOW);
  clock.receive(null);
  clock.receive("no time");
  assert.equal(clock.secondsUntil(at(5000)), 5);
});
