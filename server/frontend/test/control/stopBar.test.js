import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { Hold, StopBar, stopOnSpace } from "../../src/control/stopBar.js";
import { api } from "../../src/dom/calls.js";
import { stop } from "../../src/texts/common.js";
import { FakeElement, inside } from "../fakes.js";

let stops, clicks, window;

function press(kind, more = {}, name = "keydown") {
  const event = new Event(name, { cancelable: true });
  Object.defineProperty(event, "target", { value: inside(kind, { click: () => (clicks += 1) }) });
  window.dispatchEvent(Object.assign(event, { code: "Space", ...more }));
  return event.defaultPrevented;
}

beforeEach(() => {
  stops = 0;
  clicks = 0;
  window = new EventTarget();
  stopOnSpace(window, () => (stops += 1));
});

test("the space bar stops, once for each press, and does not scroll", () => {
  assert.equal(press("body"), true);
  assert.equal(press("body", { repeat: true }), true);
  assert.equal(stops, 1);
});

for (const kind of ["button", "select", "a", "input[type=range]", "input[type=checkbox]"]) {
  test(`on a ${kind} it stops and does not press it`, () => {
    assert.equal(press(kind), true);
    assert.equal(press(kind, {}, "keyup"), true);
    assert.equal(stops, 1);
  });
}

for (const kind of ["input:not([type=range]):not([type=checkbox])", "textarea", "[contenteditable]", "[data-hold]"]) {
  test(`in ${kind} it is what it always is`, () => {
    assert.equal(press(kind), false);
    assert.equal(stops, 0);
  });
}

test("other keys and shortcuts do not stop", () => {
  press("body", { code: "KeyW" });
  press("body", { ctrlKey: true });
  assert.equal(stops, 0);
});

test("Enter checks a checkbox, once for each press, and nothing else", () => {
  assert.equal(press("input[type=checkbox]", { code: "Enter" }), true);
  press("input[type=checkbox]", { code: "Enter", repeat: true });
  assert.equal(press("button", { code: "Enter" }), false);
  assert.deepEqual([clicks, stops], [1, 0]);
});

const STOPPED = { by: "ben", at: "2026-01-01T12:03:00Z", confirmed: true };

// The bar of a robot that is stopped, whose release has been asked for while this was offered; `answers` is what the server does.
function releaseAsked(offered = "idle") {
  Object.assign(globalThis, { window, document: { activeElement: null } });
  const root = new FakeElement();
  const calls = [];
  const bar = new StopBar(root, {
    robot: "sim1",
    halt: () => calls.push("halt"),
    send() {},
    onReleased: (again) => calls.push({ again }),
  });
  bar.stopping.press = () => calls.push("stop");
  let answer;
  mock.method(api, "release", () => new Promise((resolve) => (answer = resolve)));
  bar.receive({ stopped: STOPPED });
  bar.offer(offered);
  const done = bar.letGo();
  const text = () => bar.element.querySelector('[data-part="stop-text"]').textContent;
  const answers = (ok) => answer({ ok, detail: "" }) || done;
  return { bar, root, text, calls, answers, fails: () => answers(false) };
}

afterEach(() => mock.restoreAll());

test("the focus goes from the release button, which goes, to what came in its place", () => {
  const { bar } = releaseAsked();
  const [gone, drive] = [new FakeElement(), new FakeElement()];
  drive.hidden = false;
  bar.element.querySelector('[data-part="actions"]').querySelectorAll = () => [gone, drive];
  const focused = [];
  for (const [name, element] of Object.entries({ gone, drive, status: bar.status })) element.focus = () => focused.push(name);
  globalThis.document.activeElement = bar.release;
  bar.receive({ stopped: null });
  assert.deepEqual(focused, ["drive"]);
  bar.receive({ stopped: STOPPED });
  drive.hidden = true;
  bar.receive({ stopped: null });
  assert.deepEqual(focused, ["drive", "status"]);
});

test("a release that failed is said beside the stop that still holds", async () => {
  const { bar, text, fails } = releaseAsked();
  assert.equal(bar.release.dataset.hold, "asked");
  await fails();
  assert.equal(bar.release.dataset.hold, "idle");
  assert.match(text(), /Stopped by ben .*Release not confirmed/);
});

test("a robot that is released, though the answer was lost, is not said to be not released", async () => {
  const { bar, text, fails } = releaseAsked();
  bar.receive({ stopped: null });
  await fails();
  assert.equal(text(), "");
});

test("a release drives on only where the button said so when it was held", async () => {
  for (const [before, after, again] of [
    ["idle", "again", false],
    ["again", "idle", true],
  ]) {
    const { bar, calls, answers } = releaseAsked(before);
    bar.offer(after);
    await answers(true);
    assert.deepEqual(calls, [{ again }]);
  }
});

test("each press of Stop stops once, halts, and ends the hold of the release", () => {
  const { bar, root, calls } = releaseAsked();
  const button = root.querySelector('[data-testid="stop"]');
  const click = (detail) => button.dispatchEvent(Object.assign(new Event("click"), { detail }));
  for (const act of [() => [button.dispatchEvent(new Event("pointerdown")), click(1)], () => click(0), () => press("body")]) {
    bar.hold.begin();
    act();
    assert.deepEqual([calls.splice(0), bar.hold.state], [["stop", "halt"], "idle"]);
  }
});

test("a stop that its reader has not seen ends the hold of the release, the robot's confirmation does not", () => {
  const { bar } = releaseAsked();
  bar.hold.begin();
  bar.receive({ stopped: { ...STOPPED, confirmed: false } });
  assert.equal(bar.hold.state, "held");
  bar.receive({ stopped: { ...STOPPED, by: "ann" } });
  assert.equal(bar.hold.state, "idle");
});

test("a page whose rights have ended says that its Stop does not work, and sends it all the same", () => {
  const { bar, text, calls } = releaseAsked();
  bar.receive({ stopped: null });
  bar.end();
  bar.press();
  assert.match(text(), /Stop does not work/);
  assert.deepEqual([calls[0], bar.element.dataset.ended], ["stop", "true"]);
});

test("a stop without an answer says that a robot halts by itself only of one that does", () => {
  assert.match(stop.unheard({ guard: "ready" }), /The robot halts by itself\.$/);
  assert.match(stop.unheard({ guard: "off" }), /does not stop by itself/);
  for (const guard of ["unknown", "down", undefined]) assert.match(stop.unheard({ guard }), /halts by itself is not known/);
});

let button, clock, done, hold, states;

function send(name, more = {}) {
  const event = Object.assign(new Event(name, { cancelable: true }), more);
  button.dispatchEvent(event);
  return event;
}

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "Date"] });
  button = new EventTarget();
  done = 0;
  states = [];
  clock = null; // goes with the timers
  const now = () => clock ?? Date.now();
  hold = new Hold({ onDone: () => (done += 1), onState: (state) => states.push(state), now });
  hold.listen(button);
});

const point = (button = 0) => send("pointerdown", { button });
const key = (name, code, repeat = false) => send(name, { code, repeat });

// In steps: a timer that runs late is a freeze to the button.
function tick(ms) {
  for (let left = ms; left > 0; left -= 100) mock.timers.tick(Math.min(left, 100));
}

for (const [name, act] of [
  ...["pointerup", "pointerleave", "pointercancel", "blur"].map((end) => [`${end} before that`, () => [point(), tick(900), send(end)]]),
  ...["Enter", "Space"].map((code) => [`${code} that is let go early`, () => [key("keydown", code), tick(500), key("keyup", code)]]),
  ["a freeze of the page, which could not see the release", () => [point(), (clock = Date.now() + 60_000)]],
  ["another key", () => key("keydown", "KeyW")],
  ["another button", () => point(2)],
]) {
  test(`${name} is no release`, () => {
    act();
    tick(5000);
    assert.deepEqual([done, states.at(-1) ?? "idle"], [0, "idle"]);
  });
}

for (const [name, press, repeat, release] of [
  ["a pointer", point, () => {}, () => send("pointerup")],
  ...["Enter", "Space"].map((code) => [code, () => key("keydown", code), () => key("keydown", code, true), () => key("keyup", code)]),
]) {
  test(`${name} acts after one second of holding, once, and its repeats do not begin anew`, () => {
    assert.equal(press().defaultPrevented, name !== "a pointer");
    for (let i = 0; i < 9; i++) {
      tick(100);
      repeat();
    }
    tick(99);
    assert.equal(done, 0);
    tick(1);
    repeat();
    tick(5000);
    release();
    assert.deepEqual([done, states], [1, ["held", "idle"]]);
  });
}

test("a click of a mouse or finger does nothing, one of assistive technology has to come twice", () => {
  send("click", { detail: 1, pointerType: "" });
  send("click", { detail: 0, pointerType: "mouse" });
  assert.deepEqual(states, []);
  send("click", { detail: 0, pointerType: "" });
  assert.deepEqual(states, ["once"]);
  assert.equal(done, 0);
  send("click", { detail: 0, pointerType: "" });
  assert.equal(done, 1);
  send("click", { detail: 0 });
  mock.timers.tick(5000); // too far apart
  send("click", { detail: 0 });
  assert.equal(done, 1);
});

test("what is cancelled has to be pressed anew", () => {
  hold.cancel();
  assert.deepEqual(states, []);
  send("keydown", { code: "Enter" });
  tick(900);
  hold.cancel();
  send("keydown", { code: "Enter", repeat: true });
  tick(5000);
  assert.equal(done, 0);
  send("click", { detail: 0 });
  hold.cancel();
  send("click", { detail: 0 });
  assert.equal(done, 0);
  assert.deepEqual(states, ["held", "idle", "once", "idle", "once"]);
});
