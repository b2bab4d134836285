import assert from "node:assert/strict";
import { test } from "node:test";

import { Summary, driveRows, recordOf } from "../../src/control/driveSummary.js";
import { RecordButton } from "../../src/control/recordButton.js";
import { part } from "../../src/dom/page.js";
import { FakeElement, settle } from "../fakes.js";

const RECORDING = { id: 7, cause: "asked", state: "recording", asked_by: "ann", started_at: null };
const asked = (more) => ({ ...RECORDING, ...more });

function open(api, who = {}) {
  const root = new FakeElement();
  return { root, button: new RecordButton(root, { robot: "sim1", mac: "m1", me: "ann", level: "drive", api, ...who }) };
}

for (const [me, level, underWay, words, disabled] of [
  ["ann", "drive", null, "Record", false],
  ["ann", "drive", { state: "interrupted" }, "Record", false],
  ["ann", "drive", { state: "requested" }, "Stop recording", false],
  ["ann", "drive", { state: "ended" }, "Record", false],
  ["ann", "drive", { cause: "driven" }, "Record", false],
  ["ann", "drive", {}, "Stop recording", false],
  ["ben", "drive", {}, "Stop recording", true],
  ["ben", "manage", {}, "Stop recording", false],
  ["ann", "drive", undefined, "Record", true],
]) {
  test(`${me} with ${level} has ${disabled ? "no use of " : ""}the button ${words} of ${JSON.stringify(underWay)}`, async (context) => {
    context.mock.timers.enable({ apis: ["setTimeout"] });
    const calls = [];
    const body = { recordings: underWay ? [asked(underWay)] : [] };
    const api = {
      get: async (path, { mac }) => ({ ok: mac === "m1" && underWay !== undefined, body }),
      post: async (path) => (calls.push(path), { ok: false, detail: "cannot record robot sim1: it is disabled" }),
    };
    const { root, button } = open(api, { me, level });
    await button.refresh();
    const element = part(root, "record");
    assert.deepEqual([element.textContent, element.disabled], [words, disabled]);
    if (disabled) return;
    await button.press();
    assert.deepEqual(calls, [words === "Record" ? "/api/v1/robots/sim1/recordings?mac=m1" : "/api/v1/recordings/7/stop"]);
    assert.match(part(root, "record-state").textContent, /^Not (recorded|stopped)\. It is disabled\.$/);
  });
}

test("the second press of a double one does not stop what the first began", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const calls = [];
  const body = { recordings: /** @type {object[]} */ ([]) };
  const post = async (path) => {
    calls.push(path);
    body.recordings = [asked({})];
    return { ok: true };
  };
  const { button } = open({ get: async () => ({ ok: true, body }), post });
  await button.refresh();
  await button.press();
  await button.press();
  assert.deepEqual(calls, ["/api/v1/robots/sim1/recordings?mac=m1"]);
  context.mock.timers.tick(1200);
  await button.press();
  assert.equal(calls[1], "/api/v1/recordings/7/stop");
});

test("a late answer of before a press changes nothing", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const answers = /** @type {((answer: object) => void)[]} */ ([]);
  const api = { get: () => new Promise((resolve) => answers.push(resolve)), post: async () => ({ ok: true }) };
  const { root, button } = open(api);
  const refreshes = [button.refresh(), button.refresh()];
  answers[1]({ ok: true, body: { recordings: [asked({})] } });
  answers[0]({ ok: true, body: { recordings: [] } });
  await Promise.all(refreshes);
  assert.equal(part(root, "record").textContent, "Stop recording");
});

test("what no server answered is asked again, and problem and recording end with what came of them", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  let answer = /** @type {object} */ ({ ok: false, status: 0 });
  const api = { get: async () => answer, post: async () => ({ ok: false, detail: "" }) };
  const { root, button } = open(api);
  await button.refresh();
  answer = { ok: true, body: { recordings: [] } };
  context.mock.timers.tick(2000);
  await settle();
  assert.equal(part(root, "record").disabled, false);
  await button.press();
  assert.match(part(root, "record-state").textContent, /may have done it/);
  answer = { ok: true, body: { recordings: [asked({ started_at: "2026-11-28T11:00:00Z" })] } };
  button.receive(true);
  await settle();
  assert.match(part(root, "record-state").textContent, /^Recorded since/);
  answer = { ok: true, body: { recordings: [asked({ state: "ended" })] } };
  context.mock.timers.tick(30_000);
  await settle();
  assert.equal(part(root, "record").textContent, "Record");
});

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
