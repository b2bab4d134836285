import assert from "node:assert/strict";
import { test } from "node:test";

import { LastMinute, Rate, shortNumber, sizeText } from "../../src/topics/samples.js";

test("the last minute is kept, and nothing before it", () => {
  const samples = new LastMinute();
  for (let s = 0; s <= 90; s++) samples.push(s, 1000 * s);
  assert.deepEqual(samples.extent(90_000), { now: 90, min: 30, max: 90 });
  assert.equal(samples.extent(200_000), null);
});

test("what is no number is no point", () => {
  const samples = new LastMinute();
  samples.push(NaN, 0);
  samples.push(Infinity, 0);
  assert.equal(samples.extent(0), null);
});

test("however fast they come, so many points are kept", () => {
  const samples = new LastMinute();
  for (let i = 0; i < 5000; i++) samples.push(i, i);
  assert.equal(samples.points.length, 600);
});

test("a rate is that of the messages that came of late", () => {
  const rate = new Rate();
  assert.equal(rate.perSecond(0), null);
  assert.equal(rate.silenceMs(0), null);
  for (let at = 0; at <= 20_000; at += 500) rate.mark(at);
  assert.equal(rate.perSecond(20_000), 2);
  assert.equal(rate.silenceMs(26_000), 6000);
  assert.equal(rate.perSecond(40_000), null);
});

test("numbers are short and still tell small from none", () => {
  assert.deepEqual([0, 0.12345, -1.5, 123456.7, 0.0001234, 2.5e12, NaN].map(shortNumber), [
    "0",
    "0.123",
    "-1.5",
    "123457",
    "1.23e-4",
    "2.50e+12",
    "-",
  ]);
});

test("sizes are told in the unit that people know", () => {
  assert.deepEqual([12, 1500, 250_000, 1_230_000].map(sizeText), ["12 bytes", "1.5 KB", "250 KB", "1.2 MB"]);
});
