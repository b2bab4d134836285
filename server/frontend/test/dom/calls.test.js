import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { api, LoginUse, ServerClock } from "../../src/dom/calls.js";

let sent;

beforeEach(() => {
  sent = [];
  globalThis.document = { querySelector: () => ({ content: "csrf" }) };
  globalThis.fetch = async (path, { body }) => {
    sent.push([path, JSON.parse(body)]);
    return new Response('{"code": "not_possible", "detail": "look again"}', { status: 409 });
  };
});

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

const MINUTE = 60_000;

function make() {
  const made = { clock: 1000, asked: 0, answer: Promise.resolve() };
  made.use = new LoginUse({ ask: () => (made.asked++, made.answer), now: () => made.clock });
  return made;
}

test("a page that is used asks once in five minutes, and one that nobody touches never", () => {
  const made = make();
  made.use.note();
  assert.equal(made.asked, 0, "the page has just been loaded");
  made.clock += 5 * MINUTE;
  assert.equal(made.asked, 0);
  for (let count = 0; count < 3; count++) made.use.note();
  assert.equal(made.asked, 1);
  made.clock += 5 * MINUTE;
  made.use.note();
  assert.equal(made.asked, 2);
});

test("a press, a key and the wheel are use, wherever on the page", () => {
  const made = make();
  const page = new EventTarget();
  made.use.watch(page);
  for (const name of ["pointerdown", "keydown", "wheel"]) {
    made.clock += 5 * MINUTE;
    page.dispatchEvent(new Event(name));
  }
  page.dispatchEvent(new Event("pointermove"));
  assert.equal(made.asked, 3);
});

test("a network that is cut disturbs nothing", async () => {
  const made = make();
  made.answer = Promise.reject(new TypeError("network"));
  made.clock += 5 * MINUTE;
  made.use.note();
  await new Promise(setImmediate);
  assert.equal(made.asked, 1);
});
