import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import { api, ServerClock } from "../../src/dom/calls.js";

const { document, fetch } = globalThis;

let sent;

beforeEach(() => {
  sent = [];
  globalThis.document = { querySelector: () => ({ content: "csrf" }) };
  globalThis.fetch = async (path, { body }) => {
    sent.push([path, JSON.parse(body)]);
    return new Response('{"code": "not_possible", "detail": "look again"}', { status: 409 });
  };
});

afterEach(() => Object.assign(globalThis, { document, fetch }));

test("a release names the stop that its person saw", async () => {
  const stopped = { by: "ben", at: "2026-01-01T12:03:00Z", confirmed: true };
  const answer = await api.release("sim1", stopped);
  assert.deepEqual(sent, [["/api/v1/robots/sim1/release", { by: "ben", at: stopped.at }]]);
  assert.equal(answer.ok, false);
  assert.equal(answer.detail, "look again");
});

test("only a hand-over names somebody", async () => {
  await api.lease("sim1", "hand_over", { to: "ben" });
  await api.lease("sim1", "refuse");
  assert.deepEqual(
    sent.map(([, body]) => body),
    [{ action: "hand_over", to: "ben" }, { action: "refuse" }],
  );
});

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
