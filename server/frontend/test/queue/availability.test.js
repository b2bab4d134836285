import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Availability } from "../../src/queue/availability.js";

const START = Date.parse("2026-01-01T12:00:00Z");

let now, availability;

beforeEach(() => {
  now = START;
  availability = new Availability({ now: () => now });
});

// A heartbeat and its answer.
function heartbeat(view) {
  const sent = availability.body;
  availability.receive(view, sent);
  return sent;
}

const AVAILABLE = { state: "available", available: true };
const AWAY = { state: "away", available: false };

test("a choice is sent until the server has it, and other heartbeats change nothing", () => {
  assert.deepEqual(heartbeat(AWAY), {}, "nobody is available who did not choose it");
  availability.choose("available");
  assert.deepEqual(availability.body, { state: "available" });
  assert.deepEqual(heartbeat(AVAILABLE), { state: "available" });
  assert.deepEqual(heartbeat(AVAILABLE), {});
  availability.choose("away");
  now += 10_001;
  assert.deepEqual(availability.body, {}, "a press that did not reach the server in 10 s");
});

test("a page that slept says from when to when, and another window is told apart; Available ends both", () => {
  heartbeat(AVAILABLE);
  now += 63_000;
  heartbeat(AWAY);
  assert.deepEqual(availability.lapse, { why: "silent", from: new Date(START), to: new Date(START + 63_000) });
  availability.choose("available");
  assert.equal(availability.lapse, null);
  heartbeat(AVAILABLE);
  now += 1000;
  heartbeat(AWAY);
  assert.equal(availability.lapse.why, "other");
  availability.choose("available");
  heartbeat({ ...AVAILABLE, offer: {} });
  heartbeat(AWAY);
  assert.equal(availability.lapse.why, "unanswered");
});

// The page asks all the time, and nobody answers.
function outage(seconds) {
  for (let second = 0; second < seconds; second += 5) {
    now += 5000;
    assert.ok(availability.body);
  }
}

test("after an outage of the server the choice holds again, unless it was to be away", () => {
  heartbeat(AVAILABLE);
  outage(60);
  heartbeat(AWAY);
  assert.equal(availability.lapse, null);
  assert.deepEqual(heartbeat(AVAILABLE), { state: "available" });
  outage(30);
  availability.choose("away");
  outage(30);
  heartbeat(AWAY);
  assert.deepEqual(availability.body, {});
});

test("who chose to be away is told nothing, and is busy without being available", () => {
  heartbeat({ state: "busy", available: true });
  availability.choose("away");
  heartbeat({ state: "busy", available: false });
  assert.deepEqual([availability.lapse, availability.isAvailable], [null, false]);
});
