import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { showLocalTimes } from "../../src/dom/page.js";
import { isNew } from "../../src/dom/presses.js";
import { lineText } from "../../src/health/lines.js";
import { wireDays } from "../../src/pages/desk.js";
import { USUAL_ENDS } from "../../src/pages/grants.js";
import { appsIn, isDrawn, lineLook, stateWords, topicsIn } from "../../src/pages/routes.js";
import { driveSettings } from "../../src/pages/settings.js";
import { FakeElement } from "../fakes.js";

// Behind UTC in winter and ahead of it in summer, so that no test passes by the zone that the machine has.
process.env.TZ = "Atlantic/Azores";

test("times are the reader's own, with seconds, and with a year that is not this one", () => {
  const times = ["2026-01-31T00:03:59+00:00", "2025-07-01T12:00:00+00:00", "2026-06-01T00:00:00Z", "2026-05-31T23:59:59Z"].map(
    (dateTime) => ({ dateTime, textContent: "UTC" }),
  );
  showLocalTimes({ querySelectorAll: () => times }, new Date("2026-06-01T12:00:00Z"));
  const texts = times.map(({ textContent }) => textContent);
  assert.deepEqual(texts, ["30 Jan 23:03:59", "1 Jul 2025 12:00:00", "today 00:00:00", "yesterday 23:59:59"]);
});

test("a page takes no press that began elsewhere, nor a double one on what opened it or on a form", async () => {
  const wired = [];
  const hear = (name) => wired.push(name);
  const question = new FakeElement();
  const querySelectorAll = (selector) => (selector === "[data-settles]" ? [question] : []);
  Object.defineProperty(globalThis, "navigator", { value: {}, configurable: true }); // older Nodes have none
  Object.assign(globalThis, { document: { querySelectorAll, addEventListener: hear }, window: { addEventListener: hear } });
  const every = mock.method(globalThis, "setInterval", () => 0);
  await import("../../src/pages/desk.js?page");
  every.mock.restore();
  for (const name of ["document", "window"]) delete globalThis[name];
  assert.deepEqual(wired, ["pointerdown", "click", "keydown", "submit"]);
  assert.equal(isNew(question), true);
});

test("a filter asks for the reader's days, and for nothing where no day is given", () => {
  const field = (name, at) => ({ name, value: "", dataset: { at } });
  const days = [field("since", "2026-01-31T01:00:00Z"), field("until", "2026-02-01T01:00:00Z")];
  const form = {
    querySelectorAll: (selector) => (selector === "[data-day]" ? days : []),
    addEventListener: (_, listener) => {
      form.sent = (formData) => listener({ formData });
    },
  };
  wireDays(form);
  assert.deepEqual(
    days.map(({ value }) => value),
    ["2026-01-31", "2026-01-31"],
  );
  [days[0].value, days[1].value] = ["2026-07-01", ""];
  const query = new Map([["until", ""]]);
  form.sent(query);
  assert.deepEqual(Object.fromEntries(query), { since: "2026-07-01T00:00:00Z", until: "" });
});

test("the usual ends are in the reader's own time, and seven days are so over a change of clocks", () => {
  assert.deepEqual(Object.fromEntries(USUAL_ENDS.map(([words, end]) => [words, end(new Date("2026-03-25T12:03:59Z"))])), {
    "1 h": "2026-03-25T12:03",
    Today: "2026-03-25T23:59",
    "7 days": "2026-04-01T11:03",
    "No end": "",
  });
});

test("only what can be a topic with its type is offered, by name", () => {
  const answer = { topics: ["/b", "/a", "/c d", 7], types: ["t/B", "t/A", "t/C", "t/D"] };
  assert.deepEqual(topicsIn(answer), [
    { topic: "/a", type: "t/A" },
    { topic: "/b", type: "t/B" },
  ]);
  assert.equal(topicsIn({ topics: ["/a"], types: [] }), null);
  assert.equal(topicsIn(undefined), null);
});

test("what nobody measured is not claimed", () => {
  assert.equal(stateWords(undefined), "Not known");
  assert.deepEqual(lineLook(undefined), { state: "unknown", rate: "" });
  assert.equal(stateWords({ state: "elsewhere", rate_hz: null, why: "" }), "Not on this machine; another one may know its state");
  assert.equal(stateWords({ state: "runs", rate_hz: 0, why: "" }), "Runs, 0/s");
  assert.equal(stateWords({ state: "waits", rate_hz: 0, why: "sim1 is offline" }), "Waits: sim1 is offline");
});

test("another user's route leads to no app of this one", () => {
  const route = { source: "app:joy", target: "sim1" };
  assert.equal(isDrawn(route), false);
  assert.equal(isDrawn({ ...route, mine: "" }), true);
  assert.equal(isDrawn({ source: "sim1", target: "sim2" }), true);
});

test("an app shows with the machine that has it, and of two with one name this machine's", () => {
  const app = (name, machine) => ({ name, machine, advertises: [], subscribes: [] });
  const shown = appsIn([app("joy", null), app("joy", "b"), app("pad", "b")], [{ source: "sim1", target: "app:away" }]);
  assert.deepEqual(
    [...shown].map(([name, topics]) => [name, topics && topics.machine]),
    [
      ["app:away", null],
      ["app:joy", null],
      ["app:pad", "b"],
    ],
  );
});

const GUARD = { drive_topics: ["*/cmd_vel", "/base/move", "/other"] };
const SLOW = { max_speed_m_s: 0.5, max_turn_rad_s: null };
const FAST = { max_speed_m_s: 2, max_turn_rad_s: 3 };
const fits = (...drive_topics) => ({ guard: { drive_topics } });

for (const [what, settings, expected] of [
  ["the drive topic is the guard's first that is a name", { guard: GUARD, page: { drive_topic: null } }, { driveTopic: "/base/move" }],
  ["or the one that is set", { guard: GUARD, page: { drive_topic: "/a/cmd_vel" } }, { driveTopic: "/a/cmd_vel" }],
  ["or the usual one, where a pattern fits it", fits("*/cmd_vel"), { driveTopic: "/cmd_vel" }],
  ["or where one of several does", fits("/*/cmd_vel", "/cmd_*"), { driveTopic: "/cmd_vel" }],
  ["or where all do", fits("*"), { driveTopic: "/cmd_vel" }],
  ["and else none: of another namespace", fits("/*/cmd_vel"), { driveTopic: "" }],
  ["of another base", fits("/base*"), { driveTopic: "" }],
  ["of another end", fits("*cmd_vel_safe"), { driveTopic: "" }],
  ["the type of drive commands may be set", { page: { drive_type: "geometry_msgs/Twist" } }, { driveType: "geometry_msgs/Twist" }],
  ["old video pauses driving after a time that is set", { page: { hold_after_ms: 2500 } }, { holdAfterMs: 2500 }],
  ["or never", { page: { hold_after_ms: null } }, { holdAfterMs: null, oldMs: 1000 }],
  ["who sees late is slowed", { guard: { blind_m: null, blind_deg: 30 } }, { isLimitedByAge: true }],
  ["unless both limits are off", { guard: { blind_m: null, blind_deg: null } }, { isLimitedByAge: false }],
  ["the sliders end where the guard's limit is", { guard: SLOW, page: FAST }, { limits: { maxLinear: 0.5, maxAngular: 3 } }],
  ["a robot that steers has a wheelbase", { page: { kind: "ackermann", wheelbase_m: 0.5 } }, { kind: "ackermann", wheelbase: 0.5 }],
]) {
  test(`settings: ${what}`, () => {
    const found = driveSettings(settings);
    for (const [name, value] of Object.entries(expected)) assert.deepEqual(found[name], value, name);
  });
}

test("a line says what is known of it, and what is not is no 0", () => {
  assert.equal(
    lineText({ name: "p99", values: [0.05, null, 0.2, null] }, "seconds"),
    "99 % within: now unknown, lowest 50 ms, highest 200 ms, unknown for 50 % of the time",
  );
  assert.equal(lineText({ name: "", values: [3, 0] }, "count"), "now 0, lowest 0, highest 3");
  assert.equal(lineText({ name: "", values: [15.4, 0, 0.3] }, "count"), "now 1, lowest 0, highest 15");
  assert.equal(lineText({ name: "lost", values: [null, null] }, "count"), "driver lost: unknown for all of this time");
});
