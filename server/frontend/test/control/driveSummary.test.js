import assert from "node:assert/strict";
import { test } from "node:test";

import { Summary, driveRows, recordOf } from "../../src/control/driveSummary.js";

const DRIVE = { started_at: "2026-01-01T12:00:00Z", ended_at: "2026-01-01T12:02:05Z", distance_m: 14.24, top_speed_m_s: 0.8 };
const KNOWN = { latency_p50_ms: 41.6, latency_p95_ms: 80.2, seen_p50_ms: 140.2, seen_p95_ms: 210.6, seen_unknown: 4, slowed_s: 12.4 };
const AMOUNTS = { bytes: 1_230_000, frames: 1500, frame_bytes: 45_000_000, viewed_s: 100, stops: 1, refused: { topic: 2 }, dropped_old: 4 };
const NO_TIMES = { latency_p50_ms: null, latency_p95_ms: null, seen_p50_ms: null, slowed_s: null };
const SERVER_WORDS = { ends: { robot_stopped: "robot stopped" }, refusals: { topic: "to a topic that is not allowed" } };
const UNKNOWN = "Not measured";

for (const [what, facts, expected] of [
  ["times", KNOWN, { latency: "42 ms; 95 % within 80 ms", slowed: "12 s, as you saw late" }],
  ["ages of some commands", KNOWN, { seen: "140 ms ago; 95 % within 211 ms; unknown for 4 commands" }],
  ["times that are not known", NO_TIMES, { latency: UNKNOWN, seen: UNKNOWN, slowed: UNKNOWN }],
  ["times without slowing", { ...KNOWN, slowed_s: 0, seen_unknown: 0 }, { seen: "140 ms ago; 95 % within 211 ms", slowed: "None" }],
  ["amounts", AMOUNTS, { pictures: "15 a second, 45 MB", bytes: "1.2 MB", stops: "1" }],
  ["refusals", AMOUNTS, { refused: "2 to a topic that is not allowed, 4 too old at the server" }],
  ["nothing", { frames: 0, stops: 0, refused: {}, dropped_old: 0 }, { pictures: "No video", stops: "None", refused: "None" }],
  ["amounts that are not known", { bytes: null, frames: null }, { pictures: UNKNOWN, bytes: UNKNOWN, ended: UNKNOWN }],
  ["an end of a newer server", { end_code: "newly_made" }, { ended: "newly_made", duration: "2 min 5 s" }],
  ["the end of a drive", { end_code: "robot_stopped" }, { ended: "robot stopped", distance: "14.2 m commanded" }],
]) {
  test(`what was not measured is not written as nothing: ${what}`, () => {
    const written = driveRows({ ...DRIVE, ...facts }, SERVER_WORDS);
    for (const [row, words] of Object.entries(expected)) assert.equal(written.find(({ name }) => name === row).text, words);
  });
}

test("a record is asked for until it is there, for 10 s, and a server that does not answer is said", async () => {
  let waited = 0;
  const wait = async (ms) => (waited += ms);
  const ask = (fetchDrives) => recordOf({ robot: "sim1", fence: 13, wait, fetchDrives });
  const drive = { fence: 13, ended_at: "2026-01-01T12:03:00Z" };
  const records = [[], [{ ...drive, ended_at: null }], [{ fence: 12, ended_at: "x" }, drive]];
  const answers = [{ ok: false, body: {} }, ...records.map((drives) => ({ ok: true, body: { drives } }))];
  assert.equal(await ask(async () => answers.shift()), drive);
  assert.deepEqual([answers, waited], [[], 4000]);
  assert.equal(await ask(async () => ({ ok: true, body: {} })), "missing");
  assert.equal(waited, 14_000);
  assert.equal(await ask(async () => ({ ok: false, body: {} })), "failed");
});

test("the page's drive is the one that its own connection tells first, until that ends", () => {
  const ended = [];
  const own = new Summary({ querySelector: () => new EventTarget(), dataset: { words: "{}" } }, { robot: "sim1", me: "ann" });
  own.driveEnded = (fence) => ended.push(fence);
  own.receive({ driver: { user: "ann", fence: 12 } }, false);
  own.linkEnded();
  own.receive({ driver: { user: "ben", fence: 13 } }, true);
  own.receive({ driver: { user: "ann", fence: 14 } }, true);
  own.receive({ driver: { user: "ann", fence: 15 } }, true); // another window of hers
  own.linkEnded();
  own.linkEnded();
  assert.deepEqual(ended, [14]);
});
