import assert from "node:assert/strict";
import { test } from "node:test";

import { Summary, driveRows, headline, recordOf } from "../../src/control/driveSummary.js";

const DRIVE = {
  started_at: "2026-01-01T12:00:00Z",
  ended_at: "2026-01-01T12:02:05Z",
  end_code: "control_given_up",
  distance_m: 14.24,
  top_speed_m_s: 0.8,
  latency_p50_ms: 41.6,
  latency_p95_ms: 80.2,
  seen_p50_ms: 140.2,
  seen_p95_ms: 210.6,
  seen_unknown: 0,
  slowed_s: 12.4,
  bytes: 1_230_000,
  frames: 1500,
  frame_bytes: 45_000_000,
  viewed_s: 100,
  stops: 1,
  refused: { topic: 2, guard_old: 3 },
  dropped_old: 4,
};

const SERVER_WORDS = {
  ends: { control_given_up: "gave up control", robot_stopped: "robot stopped" },
  refusals: { topic: "to a topic that is not allowed", guard_old: "too old at the robot" },
};
const words = (drive) => Object.fromEntries(driveRows(drive, SERVER_WORDS).map(({ name, text }) => [name, text]));

test("a drive's record is written in words", () => {
  assert.equal(headline(DRIVE), "Your drive: 2 min 5 s, 14.2 m");
  assert.deepEqual(words(DRIVE), {
    duration: "2 min 5 s",
    ended: "you gave up control",
    distance: "14.2 m commanded",
    speed: "0.8 m/s commanded",
    latency: "42 ms; 95 % within 80 ms",
    seen: "140 ms ago; 95 % within 211 ms",
    slowed: "12 s, as you saw late",
    pictures: "15 a second, 45 MB",
    bytes: "1.2 MB",
    stops: "1",
    refused: "2 to a topic that is not allowed, 3 too old at the robot, 4 too old at the server",
  });
});

const NONE = {
  ...{ latency_p50_ms: null, latency_p95_ms: null, seen_p50_ms: null, slowed_s: null, bytes: null, frames: 0, viewed_s: null },
  ...{ stops: 0, refused: {}, dropped_old: 0, end_code: "newly_made" },
};
const UNKNOWN = "Not measured";

for (const [what, facts, expected] of [
  [
    "ages of some commands",
    { seen_unknown: 4, slowed_s: 0 },
    { seen: "140 ms ago; 95 % within 211 ms; unknown for 4 commands", slowed: "None" },
  ],
  ["times", NONE, { latency: UNKNOWN, seen: UNKNOWN, slowed: UNKNOWN }],
  ["amounts", NONE, { pictures: "No video", bytes: UNKNOWN, stops: "None", refused: "None", ended: "newly_made" }],
  ["frames", { frames: null, end_code: "robot_stopped" }, { pictures: UNKNOWN, ended: "robot stopped" }],
]) {
  test(`what was not measured is not written as nothing: ${what}`, () => {
    const written = words({ ...DRIVE, ...facts });
    for (const [name, text] of Object.entries(expected)) assert.equal(written[name], text, name);
  });
}

test("a record is asked for until it is there, for 10 s", async () => {
  const waits = [];
  const wait = async (ms) => waits.push(ms);
  const drive = { fence: 13, ended_at: "2026-01-01T12:03:00Z" };
  const answers = [
    { ok: false, body: {} },
    { ok: true, body: { drives: [] } },
    { ok: true, body: { drives: [{ ...drive, ended_at: null }] } },
    { ok: true, body: { drives: [{ fence: 12, ended_at: "x" }, drive] } },
  ];
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
