import assert from "node:assert/strict";
import { test } from "node:test";

import { FreshnessReporter, MainTimestamp, Sleep, freshness } from "../../src/video/freshness.js";

const seen = { offered: true, hidden: false, at: 1000 };

test("a picture is fresh up to the limit and old after it", () => {
  assert.deepEqual(freshness(seen, 1000, 2000), { state: "fresh", ageMs: 1000 });
  assert.deepEqual(freshness(seen, 1000, 2001), { state: "old", ageMs: 1001 });
});

test("no picture is none, and a robot without a camera or a hidden page is off", () => {
  assert.equal(freshness({ ...seen, at: null }, 1000, 1).state, "none");
  assert.equal(freshness({ ...seen, offered: false }, 1000, 1).state, "off");
  assert.equal(freshness({ ...seen, hidden: true }, 1000, 1).state, "off");
});

test("each change is told at once, and else ten a second at most", () => {
  const told = [];
  const reporter = new FreshnessReporter((reading) => told.push(reading.state));
  reporter.receive({ state: "fresh" }, 0);
  reporter.receive({ state: "fresh" }, 99);
  reporter.receive({ state: "old" }, 99);
  reporter.receive({ state: "old" }, 150);
  reporter.receive({ state: "old" }, 199);
  assert.deepEqual(told, ["fresh", "old", "old"]);
});

test("another camera begins with the moment of the one before and then answers for itself", () => {
  const timestamp = new MainTimestamp();
  assert.equal(timestamp.read("/a", null), null);
  assert.equal(timestamp.read("/a", 10), 10);
  assert.equal(timestamp.read("/b", null), 10);
  assert.equal(timestamp.read("/b", null), 10);
  assert.equal(timestamp.read("/b", 40), 40);
});

test("a picture that stalled before it was made the main one is as old as it is", () => {
  const timestamp = new MainTimestamp();
  timestamp.read("/a", 100);
  assert.equal(timestamp.read("/b", 20), 20);
});

test("a machine that slept is told from one that was busy or whose time of day was set back", () => {
  const sleep = new Sleep();
  assert.equal(sleep.isOver(0, 1_000_000), false);
  assert.equal(sleep.isOver(5000, 1_005_010), false);
  assert.equal(sleep.isOver(5100, 1_065_110), true);
  assert.equal(sleep.isOver(5200, 1_065_210), false);
  assert.equal(sleep.isOver(5300, 1_000_000), false);
});
