import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { SenderClock } from "../../src/client/frames.js";

let clock, wall, senderClock;

beforeEach(() => {
  clock = 1000;
  wall = 1_000_000;
  senderClock = new SenderClock({ now: () => clock, wall: () => wall });
});

function pass(ms) {
  clock += ms;
  wall += ms;
}

test("nothing is known before the first answer", () => {
  assert.equal(senderClock.timestamp(5000), null);
});

test("the least difference counts, so that a picture's age is never understated", () => {
  senderClock.receive({ t_ms: 900, sender_ms: 900 + 4000 + 80 });
  senderClock.receive({ t_ms: 950, sender_ms: 950 + 4000 + 10 });
  senderClock.receive({ t_ms: 980, sender_ms: 980 + 4000 + 300 });
  const taken = 990; // the true moment, 4990 by the sender's clock
  assert.equal(senderClock.timestamp(4990), 980);
  assert.ok(senderClock.timestamp(4990) <= taken);
});

test("no moment is to come", () => {
  senderClock.receive({ t_ms: 900, sender_ms: 900 });
  assert.equal(senderClock.timestamp(9999), 1000);
});

test("an answer counts for 30 s, in which clocks may drift apart", () => {
  senderClock.receive({ t_ms: 1000, sender_ms: 2000 });
  pass(20_000);
  senderClock.receive({ t_ms: 21_000, sender_ms: 22_050 });
  assert.equal(senderClock.timestamp(22_000), 21_000);
  pass(10_001);
  assert.equal(senderClock.timestamp(22_000), 20_950);
  pass(20_000);
  assert.equal(senderClock.timestamp(22_000), null);
});

test("after a sleep, in which this clock stood, nothing is known until the next answer", () => {
  senderClock.receive({ t_ms: 1000, sender_ms: 5000 });
  wall += 3000; // the sender's clock went on, and this page's did not
  assert.equal(senderClock.timestamp(5000), null);
  senderClock.receive({ t_ms: 1000, sender_ms: 8000 });
  assert.equal(senderClock.timestamp(5000), -2000);
});

test("an answer without numbers is none", () => {
  senderClock.receive({ t_ms: "1", sender_ms: 5000 });
  senderClock.receive({ t_ms: 1000 });
  assert.equal(senderClock.timestamp(5000), null);
});
