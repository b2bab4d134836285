import assert from "node:assert/strict";
import { beforeEach, describe, mock, test } from "node:test";

import { part, showLocalTimes } from "../../src/dom/page.js";
import { isNew } from "../../src/dom/presses.js";
import { lineText } from "../../src/health/lines.js";
import { wireDays } from "../../src/pages/desk.js";
import { USUAL_ENDS } from "../../src/pages/grants.js";
import { appsIn, isDrawn, lineLook, stateWords, topicsIn } from "../../src/pages/routes.js";
import { driveSettings } from "../../src/pages/settings.js";
import { Ticks } from "../../src/pages/ticks.js";
import { routeType } from "../../src/topics/routeDiagram.js";
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

test("a page takes no press that began elsewhere, nor a double one on what opened it or on a form, and is fresh after Back", async () => {
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
  assert.deepEqual(wired, ["pointerdown", "pointerup", "click", "keydown", "pageshow", "submit"]);
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

test("a route has its robot's type, which an app may spell as the other ROS does", () => {
  const end = (robot, type) => ({ robot, type });
  const [app, robot] = [end("app:joy", "std_msgs/String"), end("sim1", "std_msgs/msg/String")];
  assert.equal(routeType(app, robot), robot.type);
  assert.equal(routeType(robot, app), robot.type);
  assert.equal(routeType(robot, end("app:joy", "std_msgs/Bool")), null);
  assert.equal(routeType(robot, end("sim2", "std_msgs/String")), null);
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
  ["or where all do", fits("*"), { driveTopic: "/cmd_vel" }],
  ["and else none: of another namespace", fits("/*/cmd_vel"), { driveTopic: "" }],
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

describe("ticks", () => {
  const press = (element) => element.dispatchEvent(new Event("click", { cancelable: true }));

  let view, page, bar, rows, others, links, form, all;

  // A list with robots `names` on this page, and `elsewhere` on others.
  function open(names, elsewhere = []) {
    rows = names.map((value) => {
      const row = { hidden: false };
      row.box = { name: "robot", value, checked: false, closest: () => row };
      return row;
    });
    others = elsewhere.map((value) => ({ value, remove: () => (others = others.filter((other) => other.value !== value)) }));
    links = [{ href: "https://a.example/admin/robots?q=lab&page=2" }];
    [form, all] = [new FakeElement(), new FakeElement()];
    bar = Object.assign(new FakeElement(), { dataset: { one: "robot" } });
    const found = {
      'input[type="checkbox"][name="robot"]': () => rows.map(({ box }) => box),
      'input[type="hidden"][name="robot"]': () => others,
      '[data-part="ticks-all"]': () => [all],
      "form[data-keeps-ticks]": () => [form],
      "a[data-keeps-ticks]": () => links,
    };
    page = Object.assign(new FakeElement(), { querySelectorAll: (query) => found[query]() });
    view = new EventTarget();
    view.location = { href: "https://a.example/admin/robots?q=lab" };
    view.history = { state: null, replaceState: (_state, _title, href) => (view.location.href = href) };
    new Ticks(page, bar, view).wire();
  }

  const count = () => part(bar, "ticks-count").textContent;

  function tick(name, checked = true) {
    const { box } = rows.find((row) => row.box.value === name);
    box.checked = checked;
    page.dispatchEvent(Object.defineProperty(new Event("change"), "target", { value: box }));
  }

  beforeEach(() => open(["sim1", "sim2"], ["sim8", "sim9"]));

  test("what is ticked is counted, with what is on other pages or hidden by a search", () => {
    assert.deepEqual([bar.hidden, count()], [false, "2 robots ticked, 2 not shown here"]);
    tick("sim1");
    assert.equal(count(), "3 robots ticked, 2 not shown here");
    rows[0].hidden = true;
    page.dispatchEvent(new Event("input"));
    assert.equal(count(), "3 robots ticked, 3 not shown here");
  });

  test("other pages and searches of the list keep it, and so does a reload", () => {
    tick("sim2");
    const kept = "robot=sim8&robot=sim9&robot=sim2";
    assert.equal(links[0].href, `https://a.example/admin/robots?q=lab&page=2&${kept}`);
    assert.equal(view.location.href, `https://a.example/admin/robots?q=lab&${kept}`);
    const formData = new FormData();
    form.dispatchEvent(Object.assign(new Event("formdata"), { formData }));
    assert.deepEqual(formData.getAll("robot"), ["sim8", "sim9", "sim2"]);
    tick("sim2", false);
    assert.equal(view.location.href, "https://a.example/admin/robots?q=lab&robot=sim8&robot=sim9");
  });

  test("it is cleared everywhere at once", () => {
    tick("sim1");
    press(part(bar, "ticks-clear"));
    assert.deepEqual([bar.hidden, rows[0].box.checked, others], [true, false, []]);
    assert.equal(links[0].href, "https://a.example/admin/robots?q=lab&page=2");
  });

  test("one press ticks all that is shown, and the next none of it", () => {
    rows[1].hidden = true;
    assert.equal(all.hidden, false);
    for (const expected of [true, false]) {
      press(all);
      assert.deepEqual([rows[0].box.checked, rows[1].box.checked], [expected, false]);
    }
    assert.equal(count(), "2 robots ticked, 2 not shown here");
  });

  test("no more is ticked than an address holds", () => {
    const names = Array.from({ length: 120 }, (_, at) => `sim${at}`);
    open(names, ["last"]);
    press(all);
    const ticked = () => rows.filter(({ box }) => box.checked).length;
    assert.equal(ticked(), 99);
    assert.equal(count(), "100 robots ticked, 1 not shown here. At most 100 robots at once.");
    tick("sim119");
    assert.equal(ticked(), 99);
  });
});
