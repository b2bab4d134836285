import assert from "node:assert/strict";
import { test } from "node:test";

import { recordOf } from "../../src/control/driveRecord.js";

test("a record is asked for until it is there, for 10 s", async () => {
  const waits = [];
  const wait = async (ms) => waits.push(ms);
  const drive = { fence: 13, ended_at: "2026-01-01T12:03:00Z" };
  const answers = [{ ok: false, body: {} }, { ok: true, body: { drives: [] } }, { ok: true, body: { drives: [{ ...drive, ended_at: null }] } }, { ok: true, body: { drives: [{ fence: 12, ended_at: "x" }, drive] } }];
  const found = await recordOf({ robot: "sim1", fence: 13, wait, fetchDrives: async () => answers.shift() });
  assert.equal(found, drive);
  assert.equal(waits.length, 4);
});

test("a record that does not come is missing, and a server that does not answer is said", async () => {
  let waited = 0;
  const wait = async (ms) => (waited += ms);
  const ask = (ok) => recordOf({ robot: "sim1", fence: 13, wait, fetchDrives: async () => ({ ok, body: {} }) });
  assert.equal(await ask(true), "missing");
  assert.equal(waited, 10_000);
  assert.equal(await ask(false), "failed");
});
