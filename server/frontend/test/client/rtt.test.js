import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { RttProbe } from "../../src/client/rtt.js";

let clock, calls, reading, probe;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = 0;
  calls = [];
  probe = new RttProbe({
    call: (service) => new Promise((resolve, reject) => calls.push({ service, resolve, reject })),
    onReading: (value) => (reading = value),
    now: () => clock,
  });
});

const pass = async (ms) => {
  clock += ms;
  mock.timers.tick(ms);
  await Promise.resolve();
};

const answer = async (result) => {
  calls.at(-1).resolve(result);
  for (let i = 0; i < 5; i++) await Promise.resolve();
};

test("an answer that says that the service failed counts, one call is under way at a time, and the age of the last answer grows while none comes, until it stops", async () => {
  probe.start();
  clock += 40;
  await answer({ ok: false });
  assert.deepEqual(reading, { medianMs: 40, ageMs: 0 });
  await pass(1000);
  await pass(1000);
  assert.equal(calls.length, 2);
  assert.equal(reading.ageMs, 2000);
  probe.stop();
  assert.equal(reading, null);
});

test("a call without an answer is given up after five seconds, and its late answer ignored", async () => {
  probe.start();
  for (let i = 0; i < 5; i++) await pass(1000);
  assert.equal(calls.length, 2);
  calls[0].resolve({ ok: true });
  await Promise.resolve();
  assert.equal(reading, null);
});
