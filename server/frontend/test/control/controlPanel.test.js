import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { afterTicketRefusal, LINK_LOST, LIVE } from "../../src/client/connection.js";
import { Banner, ControlPanel, isSlow, Question, selectStatus, silenceOf } from "../../src/control/controlPanel.js";
import { DriveMode } from "../../src/control/driveMode.js";
import { byTestId, part } from "../../src/dom/page.js";
import { connection, states } from "../../src/texts/common.js";
import { FakeElement } from "../fakes.js";

const CONNECTED = { live: true, waits: false };
const MAC = "00:1b:44:11:3a:b7";
const AWAY = { live: false, waits: true };

let root, driveMode;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  panel = null;
  globalThis.document = root = new FakeElement();
  driveMode = new DriveMode({ me: "ann", level: "manage", onMove() {}, onChange: () => panel?.show(CONNECTED) });
});

let panel;
const open = (options) => (panel = new ControlPanel(root, { robot: "sim1", mac: MAC, driveMode, driveTopic: "/cmd_vel", ...options }));
const note = () => byTestId(root, "control-note");

test("a robot without a drive topic is said to have none, for as long as the page is open", () => {
  open({ driveTopic: "" });
  driveMode.receive({});
  mock.timers.tick(60_000);
  assert.match(note().textContent, /no drive topic/);
  assert.equal(note().dataset.fresh, "true");
});

test("what a guard does not do is said: answer, stop the robot, or slow it by the settings, which may be unknown", () => {
  for (const [guard, isLimitedByAge, blind_limits, expected] of [
    ["down", false, true, /does not answer/],
    ["off", false, true, /does not stop by itself/],
    ["ready", true, false, /too old to drive slower/],
    ["ready", true, true, /^$/],
    ["ready", true, null, /^$/],
    ["ready", false, false, /^$/],
  ]) {
    open({ isLimitedByAge });
    driveMode.receive({ guard, blind_limits });
    assert.match(note().textContent, expected);
  }
});

test("who drives is left out while it is not known", () => {
  open();
  const driver = () => part(byTestId(root, "control"), "driver").textContent;
  panel.show(CONNECTED);
  assert.equal(driver(), "");
  driveMode.receive({ driver: null });
  assert.equal(driver(), "Nobody is driving");
  panel.show(AWAY);
  assert.equal(driver(), "");
});

test("who asks for control in another's place gets no answer that was meant for that one", () => {
  let clock = 0;
  const now = mock.method(performance, "now", () => clock);
  open({ busy: () => false });
  driveMode.drive();
  const asks = (user) => {
    const driver = { user: "ann", since: "2026-01-01T12:03:00Z", fence: 1 };
    driveMode.receive({ driver, waiting: { user, passes_at: "2026-01-01T12:04:00Z" } });
    return byTestId(root, "question").dispatchEvent(new Event("click", { cancelable: true }));
  };
  assert.equal(asks("ben"), false);
  clock += 1300;
  assert.equal(asks("ben"), true);
  assert.equal(asks("cleo"), false);
  now.mock.restore();
});

test("control is handed over to the person of the question, and to nobody else who asks by then", async (context) => {
  const fetch = context.mock.method(globalThis, "fetch", async () => new Response("{}"));
  open({ busy: () => false });
  driveMode.drive();
  const driver = { user: "ann", since: "2026-01-01T12:03:00Z", fence: 1 };
  driveMode.receive({ driver, waiting: { user: "ben", passes_at: "2026-01-01T12:04:00Z" } });
  panel.button("hand-over").dispatchEvent(new Event("click"));
  const [path, { body }] = fetch.mock.calls[0].arguments;
  assert.deepEqual(
    [path, JSON.parse(body)],
    [`/api/v1/robots/sim1/lease?${new URLSearchParams({ mac: MAC })}`, { action: "hand_over", to: "ben" }],
  );
});

test("whether to take control is asked of one driver, and not answered for the next", (context) => {
  const fetch = context.mock.method(globalThis, "fetch", async () => new Response("{}"));
  open({ busy: () => false });
  const driver = (user) => driveMode.receive({ driver: { user, since: "2026-01-01T12:03:00Z", fence: 1 } });
  driver("ben");
  panel.button("take").dispatchEvent(new Event("click"));
  driver("ben");
  assert.equal(byTestId(root, "take-sure").hidden, false);
  driver("cleo");
  assert.equal(byTestId(root, "take-sure").hidden, true);
  panel.button("take").dispatchEvent(new Event("click"));
  panel.button("take-yes").dispatchEvent(new Event("click"));
  assert.deepEqual(JSON.parse(fetch.mock.calls[0].arguments[1].body), { action: "take", driver: "cleo" });
});

test("a page that is older than rights or settings says so, once it is connected again", () => {
  open();
  panel.outdated = true;
  panel.show(AWAY);
  assert.equal(note().textContent, "");
  panel.show(CONNECTED);
  mock.timers.tick(60_000);
  assert.match(note().textContent, /settings have changed. Reload/);
  assert.equal(note().dataset.fresh, "true");
});

test("what takes the place of another button acts on no second press, by pointer or key", () => {
  driveMode = new DriveMode({ me: "ann", level: "drive", drove: { armed: false }, onMove() {} });
  open();
  const buttons = ["arm", "leave"].map((name) => panel.button(name));
  part(root, "actions").querySelectorAll = () => buttons;
  buttons.forEach((button, at) => (button.dataset.action = ["arm", "leave"][at]));
  const press = (name) => panel.button(name).dispatchEvent(new Event("click"));
  panel.showActions(["arm"]);
  press("arm");
  panel.showActions(["leave"]);
  press("leave");
  assert.deepEqual([driveMode.mode, driveMode.armed], ["drive", true]);
  mock.timers.tick(1199);
  press("leave");
  assert.equal(driveMode.mode, "drive");
  mock.timers.tick(1);
  press("leave");
  assert.equal(driveMode.mode, "observe");
});

let actions, button, banner;

beforeEach(() => {
  actions = [];
  button = part(byTestId(root, "state"), "state-action");
  banner = new Banner(root, { onRetry: () => actions.push("retry"), onBlind: () => actions.push("blind") });
});

const held = () => banner.show(LIVE, { control: {}, driving: true, video: "missing" });
const press = () => button.dispatchEvent(new Event("click"));

test("a press that was meant for what the button was before lets nobody drive without video", () => {
  banner.show(LINK_LOST, {});
  press();
  held();
  press();
  mock.timers.tick(1199);
  held();
  press();
  assert.deepEqual(actions, ["retry"]);
  assert.equal(button.textContent, "Drive without video");
});

test("who has had the time to read it, or saw no button before, may drive without video", () => {
  banner.show(LINK_LOST, {});
  held();
  mock.timers.tick(1200);
  press();
  banner.show(LIVE, { control: {}, driving: true, video: "seen" });
  mock.timers.tick(1200);
  held();
  press();
  assert.deepEqual(actions, ["blind", "blind"]);
});

let clock, busy, element, question;

beforeEach(() => {
  clock = 1000;
  busy = false;
  element = new FakeElement();
  question = new Question(element, { busy: () => busy, now: () => clock });
});

// Whether a click gets through to a button.
function click() {
  const event = new Event("click", { cancelable: true });
  event.stopPropagation = mock.fn();
  element.dispatchEvent(event);
  return event.stopPropagation.mock.callCount() === 0;
}

test("a question is deaf while a key or stick is held, and looks so", () => {
  question.show(true);
  clock += 1300;
  busy = true;
  assert.equal(click(), false);
  mock.timers.tick(100);
  assert.equal(element.dataset.deaf, "true");
  busy = false;
  assert.equal(click(), true);
  mock.timers.tick(100);
  assert.equal(element.dataset.deaf, "false");
});

const texts = { ...connection, ...states };
const FINE = { control: { stopped: null, guard: "ready" }, driving: true, video: "seen" };
const GONE = afterTicketRefusal({ status: 404, code: "robot_unknown" });
const DOWN = { guard: "down" };
const stoppedBy = (confirmed) => ({ stopped: { by: "ben", at: "", confirmed }, ...DOWN });

// The one state that is shown, out of the connection's and all else that is true at once.
for (const [status, state, facts] of [
  ["live", LIVE, {}],
  ["live", LIVE, { video: "off" }],
  ["live", LIVE, { disabled: true, control: undefined }],
  ["offline", { name: "offline" }, { control: stoppedBy(true), video: "old" }],
  ["disabled", { name: "offline" }, { disabled: true }],
  ["disabled", { name: "link_lost" }, { disabled: true }],
  ["not_allowed", { name: "not_allowed" }, { disabled: true }],
  ["server_unreachable", { name: "server_unreachable" }, { disabled: true }],
  ["gone", GONE, { disabled: true }],
  ["renamed", GONE, { renamed: "crane" }],
  ["not_allowed", afterTicketRefusal({ status: 403, code: "grant_missing" }), { renamed: "" }],
  ["stopping", LIVE, { control: stoppedBy(false), video: "old", silentS: 1 }],
  ["stopped", LIVE, { control: stoppedBy(true), silentS: 1 }],
  ["guard_down", LIVE, { control: DOWN, video: "old", silentS: 1 }],
  ["silent", LIVE, { video: "old", silentS: 1 }],
  ["silent", LIVE, { driving: false, silentS: 1 }],
  ["held", LIVE, { video: "old", slow: true }],
  ["held", LIVE, { video: "missing" }],
  ["slow", LIVE, { slow: true }],
  ["slow", LIVE, { slow: true, video: "blind" }],
  ["blind", LIVE, { video: "blind" }],
  ["live", LIVE, { driving: false, video: "old" }],
  ["live", LIVE, { driving: false, slow: true }],
]) {
  test(`the state ${status} is shown of a connection that is ${state.name} with ${JSON.stringify(facts)}`, () => {
    assert.equal(selectStatus(state, { ...FINE, ...facts }), status);
    assert.ok(status in texts);
  });
}

test("a network is too slow when half the way there and back is more than the guard allows", () => {
  const slow = (server, robot, maxAgeMs = 500) => isSlow({ server, robot }, maxAgeMs);
  assert.deepEqual([slow(500, 501), slow(500, 501, 800), slow(500, 500), slow(null, 5), slow(5)], [true, false, false, false, false]);
});

test("silence of server and video together says whether the robot halts, and offers no driving without video", () => {
  const { headline, detail, action } = states.silent;
  assert.equal(`${headline({ silentS: 3 })} ${detail(FINE)}`, "No connection for 3 s. Without commands the robot halts by itself.");
  assert.equal(action, undefined);
  assert.match(detail({ control: { guard: "off" } }), /does not stop by itself/);
  assert.match(detail({ control: { guard: "unknown" } }), /not known/);
  assert.equal(connection.link_lost.detail({ reason: "", driving: false }), "This page reconnects by itself."); // another may drive
});

test("silence counts from when the later of both came, in whole seconds", () => {
  assert.deepEqual([silenceOf(999, 5000), silenceOf(5000, 400), silenceOf(1000, 5000), silenceOf(3999, null)], [0, 0, 1, 3]);
});
