import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { ControlPanel } from "../../src/control/controlPanel.js";
import { DriveMode } from "../../src/control/driveMode.js";
import { FakeElement } from "./fakes.js";

const LIVE = { live: true, waits: false };
const AWAY = { live: false, waits: true };

let before, root, driveMode;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  before = globalThis.document;
  globalThis.document = root = new FakeElement();
  driveMode = new DriveMode({ me: "ann", level: "manage", onMove() {}, onChange: () => panel?.show(LIVE) });
});

afterEach(() => {
  globalThis.document = before;
  panel = null;
});

let panel = null;
const open = (options) => (panel = new ControlPanel(root, { robot: "sim1", driveMode, driveTopic: "/cmd_vel", ...options }));
const byTestId = (name) => root.querySelector(`[data-testid="${name}"]`);
const note = () => byTestId("control-note");

test("a robot without a drive topic is said to have none, for as long as the page is open", () => {
  open({ driveTopic: "" });
  driveMode.receive({});
  mock.timers.tick(60_000);
  assert.match(note().textContent, /no drive topic/);
  assert.equal(note().dataset.fresh, "true");
});

test("who drives is left out while it is not known", () => {
  open();
  const driver = () => byTestId("control").querySelector('[data-part="driver"]').textContent;
  panel.show(LIVE);
  assert.equal(driver(), "");
  driveMode.receive({ driver: null });
  assert.equal(driver(), "Nobody is driving");
  panel.show(AWAY);
  assert.equal(driver(), "");
});

test("what happens again is said again, after it has gone from the picture", () => {
  open();
  driveMode.receive({ driver: { user: "ben", since: "2026-01-01T12:03:00Z", fence: 1 } });
  driveMode.press();
  mock.timers.tick(9000);
  panel.show();
  assert.equal(note().dataset.fresh, "false");
  driveMode.press();
  assert.match(note().textContent, /ben is driving/);
  assert.equal(note().dataset.fresh, "true");
});

test("whether to take control is asked of one driver, and not answered for the next", () => {
  open();
  const driver = (user) => driveMode.receive({ driver: { user, since: "2026-01-01T12:03:00Z", fence: 1 } });
  driver("ben");
  panel.button("take").dispatchEvent(new Event("click"));
  driver("ben");
  assert.equal(byTestId("take-sure").hidden, false);
  driver("cleo");
  assert.equal(byTestId("take-sure").hidden, true);
});

test("a page that is older than rights or settings says so, once it is connected again", () => {
  open();
  panel.outdated = true;
  panel.show(AWAY);
  assert.equal(note().textContent, "");
  panel.show(LIVE);
  mock.timers.tick(60_000);
  assert.match(note().textContent, /settings have changed. Reload/);
  assert.equal(note().dataset.fresh, "true");
});

test("what takes the place of another button acts on no second press, by pointer or key", () => {
  driveMode = new DriveMode({ me: "ann", level: "drive", drove: { armed: false }, onMove() {} });
  open();
  const buttons = ["arm", "leave"].map((name) => panel.button(name));
  root.querySelector('[data-part="actions"]').querySelectorAll = () => buttons;
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
