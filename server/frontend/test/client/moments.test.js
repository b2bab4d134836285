import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Moments } from "../../src/client/moments.js";

let clock, wall, moments;

beforeEach(() => {
  clock = 1000;
  wall = 1_000_000;
  moments = new Moments({ now: () => clock, wall: () => wall });
});

function pass(ms) {
  clock += ms;
  wall += ms;
}

test("nothing is known before the first answer", () => {
  assert.equal(moments.at(5000), null);
});

test("the least difference counts, so that a picture's age is never understated", () => {
  moments.hear({ t_ms: 900, sender_ms: 900 + 4000 + 80 });
  moments.hear({ t_ms: 950, sender_ms: 950 + 4000 + 10 });
  moments.hear({ t_ms: 980, sender_ms: 980 + 4000 + 300 });
  const taken = 990; // the true moment, 4990 by the sender's clock
  assert.equal(moments.at(4990), 980);
  assert.ok(moments.at(4990) <= taken);
});

test("no moment is to come", () => {
  moments.hear({ t_ms: 900, sender_ms: 900 });
  assert.equal(moments.at(9999), 1000);
});

test("an answer counts for 30 s, in which clocks may drift apart", () => {
  moments.hear({ t_ms: 1000, sender_ms: 2000 });
  pass(20_000);
  moments.hear({ t_ms: 21_000, sender_ms: 22_050 });
  assert.equal(moments.at(22_000), 21_000);
  pass(10_001);
  assert.equal(moments.at(22_000), 20_950);
  pass(20_000);
  assert.equal(moments.at(22_000), null);
});

test("after a sleep, in which this clock stood, nothing is known until the next answer", () => {
  moments.hear({ t_ms: 1000, sender_ms: 5000 });
  wall += 3000; // the sender's clock went on, and this page's did not
  assert.equal(moments.at(5000), null);
  moments.hear({ t_ms: 1000, sender_ms: 8000 });
  assert.equal(moments.at(5000), -2000);
});

test("an answer without numbers is none", () => {
  moments.hear({ t_ms: "1", sender_ms: 5000 });
  moments.hear({ t_ms: 1000 });
  assert.equal(moments.at(5000), null);
});
