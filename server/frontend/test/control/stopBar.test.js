import assert from "node:assert/strict";
import { afterEach, beforeEach, describe, mock, test } from "node:test";

import { Hold, StopBar, stopOnSpace } from "../../src/control/stopBar.js";
import { Stopping, sameStop } from "../../src/control/stopping.js";
import { api } from "../../src/dom/calls.js";
import { stop as texts } from "../../src/texts/common.js";
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
  bar.know(false);
  assert.match(text(), /not known now/, "somebody else may release it");
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

describe("a stop on its way", () => {
  const OK = { ok: true, status: 200, detail: "" };
  const NO_ANSWER = { ok: false, status: 0, detail: "" };
  const BUSY = { ok: false, status: 429, detail: "" };
  const DOWN = { ok: false, status: 503, detail: "" };
  const BY_BEN = { by: "ben", at: "2026-01-01T12:03:00Z" };

  let ways, answers, presses, stopping;

  beforeEach(() => {
    mock.timers.reset();
    mock.timers.enable({ apis: ["setTimeout"] });
    ways = [];
    answers = [];
    presses = [];
    stopping = new Stopping({
      send: (id) => presses.push(id) && ways.push("link"),
      post: (id) => {
        presses.push(id);
        ways.push("post");
        return new Promise((resolve) => answers.push(resolve));
      },
      onChange: () => {},
    });
  });

  async function answer(what, nth = -1) {
    answers.at(nth)(what);
    for (let i = 0; i < 5; i++) await Promise.resolve();
  }

  const press = () => stopping.press();
  const receive = (stopped) => stopping.receive(stopped);
  const stoppedBy = (by, confirmed = true) => receive({ by, at: BY_BEN.at, confirmed });
  const tick = (ms) => mock.timers.tick(ms);
  const kind = () => stopping.shown.kind;

  test("only what is confirmed is said: server, then robot", async () => {
    press();
    await answer(OK);
    assert.deepEqual([kind(), stopping.holds], ["heard", true]);
    stoppedBy("ben", false);
    assert.equal(kind(), "stopping");
    stoppedBy("ben");
    assert.deepEqual([stopping.shown, stopping.holds], [{ kind: "stopped", by: "ben", at: BY_BEN.at }, true]);
    receive(null);
    assert.equal(kind(), "none");
  });

  test("both ways of an attempt say the same press, and the next attempt another", async () => {
    press();
    await answer(NO_ANSWER);
    tick(1000);
    const [link, post, next] = presses;
    assert.deepEqual([link === post, link === next, presses.length], [true, false, 4]);
  });

  test("the attempts end after a while, ask for another press and then keep nobody from going on", async () => {
    assert.equal(stopping.holds, false);
    press();
    for (let i = 0; i < 15; i++) {
      assert.equal(stopping.holds, true);
      await answer(NO_ANSWER);
      tick(1000);
    }
    assert.deepEqual([kind(), stopping.holds, ways.length], ["failed", false, 30]);
    tick(60_000);
    assert.equal(ways.length, 30);
  });

  test("a refusal is final and gives its reason", async () => {
    press();
    await answer({ ok: false, status: 404, detail: "there is no such robot" });
    assert.deepEqual([kind(), stopping.holds], ["refused", false]);
    tick(60_000);
    assert.deepEqual(ways, ["link", "post"]);
    assert.match(texts.refused(stopping.shown), /no such robot/);
  });

  // What is said after some steps, each with the answer that comes then, and how often the stop was sent on both ways.
  for (const [name, steps, said, times] of [
    ["a press goes out on both ways before either has answered", [press], "asked", 1],
    ["a second press is said again at once", [press, press], "asked", 2],
    ["a late answer to the press before says nothing", [press, press, () => answer(OK, 0)], "asked", 2],
    ["without an answer it is said again", [press, NO_ANSWER, () => tick(1000), OK], "heard", 2],
    ["what was heard of on another way ends the attempts", [press, NO_ANSWER, () => stoppedBy("ben"), () => tick(60_000)], "stopped", 1],
    ["a late answer to a stop that was released says nothing", [press, () => stoppedBy("ben"), () => receive(null), NO_ANSWER], "none", 1],
    ["no news of a stop hides none that is on its way", [press, () => receive(null)], "asked", 1],
    ["nor one that the server has, for a while", [press, () => receive(null), OK, () => receive(null)], "heard", 1],
    ["nor longer", [press, () => receive(null), OK, () => receive(null), () => tick(5000)], "none", 1],
    [
      "one that the server has is not forgotten while the page hears nothing",
      [() => receive(null), press, OK, () => tick(60_000)],
      "heard",
      1,
    ],
    ["until it hears something", [press, OK, () => tick(60_000), () => receive(null), () => tick(5000)], "none", 1],
    ["the release of an earlier stop ends none on its way", [() => stoppedBy("ben"), press, () => receive(null), NO_ANSWER], "unheard", 1],
    ["nor one that was not heard yet", [() => stoppedBy("ben"), press, NO_ANSWER, () => receive(null), () => tick(1000)], "unheard", 2],
    ["a server that is busy or down is told again", [press, BUSY, () => tick(1000), DOWN, () => tick(1000)], "unheard", 3],
  ]) {
    test(name, async () => {
      for (const step of steps) await (typeof step === "function" ? step() : answer(step));
      assert.deepEqual([kind(), ways], [said, Array(times).fill(["link", "post"]).flat()]);
    });
  }

  test("news of somebody else's earlier stop does not end a stop that is on its way", async () => {
    stoppedBy("ben", false);
    press();
    stoppedBy("ben");
    await answer(NO_ANSWER);
    tick(1000);
    assert.deepEqual(ways, ["link", "post", "link", "post"]);
    stoppedBy("me");
    await answer(NO_ANSWER);
    tick(60_000);
    assert.deepEqual([ways.length, stopping.shown.by], [4, "me"]);
  });

  test("a stop is another one by its name or timestamp, not by its confirmation", () => {
    assert.ok(sameStop({ ...BY_BEN, confirmed: false }, { ...BY_BEN, confirmed: true }));
    assert.ok(sameStop(null, undefined));
    assert.ok(!sameStop(BY_BEN, null));
    assert.ok(!sameStop(BY_BEN, { ...BY_BEN, by: "ann" }));
    assert.ok(!sameStop(BY_BEN, { ...BY_BEN, at: "2026-01-01T12:03:01Z" }));
  });

  test("every kind has its sentence, and only a confirmed stop is called one", () => {
    const facts = { by: "ben", at: "12:03", detail: "" };
    for (const name of ["asked", "heard", "unheard", "failed", "refused", "stopping", "stopped"]) {
      assert.ok(texts[name](facts), name);
      assert.equal(texts[name](facts).startsWith("Stopped"), name === "stopped");
    }
    assert.match(texts.unheard({ guard: "ready" }), /Without commands the robot halts/); // another person may drive it on
    assert.match(texts.unheard({ guard: "off" }), /does not stop by itself/);
    assert.match(texts.unheard({}), /halts by itself is not known/);
  });
});
