import assert from "node:assert/strict";
import { test } from "node:test";

import { part } from "../../src/dom/page.js";
import { RecordButton } from "../../src/control/recordButton.js";
import { FakeElement, settle } from "../fakes.js";

const NOW = Date.parse("2026-11-28T12:00:00Z");
const RECORDING = { id: 7, cause: "asked", state: "recording", asked_by: "ann", asked_at: "2026-11-28T11:00:00Z", started_at: null };
const asked = (more) => ({ ...RECORDING, ...more });

for (const [me, level, underWay, words, disabled] of [
  ["ann", "drive", null, "Record", false],
  ["ann", "drive", { state: "requested" }, "Record", false], // an hour ago, and nobody began it
  ["ann", "drive", { state: "requested", asked_at: "2026-11-28T11:59:30Z" }, "Stop recording", false],
  ["ann", "drive", { state: "ended" }, "Record", false],
  ["ann", "drive", { cause: "driven" }, "Record", false],
  ["ann", "drive", {}, "Stop recording", false],
  ["ben", "drive", {}, "Stop recording", true],
  ["ben", "manage", {}, "Stop recording", false],
  ["ann", "drive", undefined, "Record", true],
]) {
  test(`${me} with ${level} has ${disabled ? "no use of " : ""}the button ${words} of ${JSON.stringify(underWay)}`, async (context) => {
    context.mock.timers.enable({ apis: ["setTimeout"] });
    const root = new FakeElement();
    const calls = [];
    const body = { recordings: underWay ? [asked(underWay)] : [] };
    const api = {
      get: async () => ({ ok: underWay !== undefined, body }),
      post: async (path) => (calls.push(path), { ok: false, detail: "cannot record robot sim1: it is disabled" }),
    };
    const button = new RecordButton(root, { robot: "sim1", me, level, api, now: () => NOW });
    await button.refresh();
    const element = part(root, "record");
    assert.deepEqual([element.textContent, element.disabled], [words, disabled]);
    if (disabled) return;
    await button.press();
    assert.deepEqual(calls, [words === "Record" ? "/api/v1/robots/sim1/recordings" : "/api/v1/recordings/7/stop"]);
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
  const options = { robot: "sim1", me: "ann", level: "drive", now: () => NOW };
  const button = new RecordButton(new FakeElement(), { ...options, api: { get: async () => ({ ok: true, body }), post } });
  await button.refresh();
  await button.press();
  await button.press();
  assert.deepEqual(calls, ["/api/v1/robots/sim1/recordings"]);
  context.mock.timers.tick(1200);
  await button.press();
  assert.equal(calls[1], "/api/v1/recordings/7/stop");
});

test("a late answer of before a press changes nothing", async () => {
  const answers = /** @type {((answer: object) => void)[]} */ ([]);
  const api = { get: () => new Promise((resolve) => answers.push(resolve)), post: async () => ({ ok: true }) };
  const root = new FakeElement();
  const button = new RecordButton(root, { robot: "sim1", me: "ann", level: "drive", now: () => NOW, api });
  const refreshes = [button.refresh(), button.refresh()];
  answers[1]({ ok: true, body: { recordings: [asked({})] } });
  answers[0]({ ok: true, body: { recordings: [] } });
  await Promise.all(refreshes);
  assert.equal(part(root, "record").textContent, "Stop recording");
});

test("what no server answered is asked again, and a problem ends with what came of it", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const root = new FakeElement();
  let answer = /** @type {object} */ ({ ok: false, status: 0 });
  const api = { get: async () => answer, post: async () => ({ ok: false, detail: "" }) };
  const button = new RecordButton(root, { robot: "sim1", me: "ann", level: "drive", now: () => NOW, api });
  await button.refresh();
  answer = { ok: true, body: { recordings: [] } };
  context.mock.timers.tick(2000);
  await settle();
  assert.equal(part(root, "record").disabled, false);
  await button.press();
  assert.match(part(root, "record-state").textContent, /^Not recorded/);
  answer = { ok: true, body: { recordings: [asked({ started_at: "2026-11-28T11:00:00Z" })] } };
  button.receive(true);
  await settle();
  assert.match(part(root, "record-state").textContent, /^Recorded since/);
});
