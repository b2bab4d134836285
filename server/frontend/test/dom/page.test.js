import assert from "node:assert/strict";
import { describe, mock, test } from "node:test";

import { LoginUse, ServerClock } from "../../src/dom/calls.js";
import { KeyedRows } from "../../src/dom/keyedRows.js";
import { Choices, LocalStore, freshPage, reloadOnReturn, shortNumber } from "../../src/dom/page.js";
import { Presses, askOnce, markOpened, sendOnce } from "../../src/dom/presses.js";
import { ScreenLock } from "../../src/dom/screenLock.js";
import { FakeElement, settle, storageOf } from "../fakes.js";

test("what is not JSON, what was never written, and all of a browser that keeps nothing, is nothing", () => {
  const store = storageOf(new Map([["robotether.sticks", "{"]]));
  const blocked = () => {
    throw new Error("blocked");
  };
  for (const kept of [new LocalStore(() => store), new LocalStore(blocked)]) {
    assert.deepEqual([kept.read("sticks"), kept.read("other")], [null, null]);
  }
  const kept = new LocalStore(blocked);
  kept.write("sticks", true);
  kept.forget("sticks");
});

test("a page that Back brings out of the browser's memory is loaded anew, and no other", () => {
  const [window, reload] = [new EventTarget(), mock.fn()];
  reloadOnReturn(window, reload);
  for (const persisted of [false, true]) window.dispatchEvent(Object.assign(new Event("pageshow"), { persisted }));
  assert.equal(reload.mock.callCount(), 1);
});

test("choices are those of their name, nonsense is none, and what is chosen anew leaves the others", () => {
  const store = storageOf(new Map([["robotether.sight.sim2", "7"]]));
  const choices = (name) => new Choices(name, new LocalStore(() => store));
  choices("sight.sim1").keep({ quality: "50" });
  choices("sight.sim1").keep({ laser: true });
  assert.deepEqual(choices("sight.sim1").all, { quality: "50", laser: true });
  assert.deepEqual([choices("sight.sim2").all, choices("sight.sim3").all], [{}, {}]);
  choices("controls.sim1").keep({ speed: null, map: "x", layout: { kind: "grid" } });
  const groups = ["speed", "map", "layout"].map((name) => choices("controls.sim1").group(name));
  assert.deepEqual(groups, [{}, {}, { kind: "grid" }]);
});

test("numbers are short and still tell small from none", () => {
  const numbers = [0, 0.12345, -1.5, 123456.7, 0.0001234, 2.5e12, NaN];
  assert.equal(numbers.map(shortNumber).join(), "0,0.123,-1.5,123457,1.23e-4,2.50e+12,-");
});

test("a page that comes late does not take the place of one that was asked for after it", async () => {
  const answers = [];
  globalThis.fetch = () => new Promise((answer) => answers.push((text) => answer({ ok: true, text: async () => text })));
  globalThis.DOMParser = class {
    parseFromString = (text) => ({ text, querySelectorAll: () => [] });
  };
  const pages = [freshPage("/routes"), freshPage("/routes"), freshPage("/routes")];
  answers[1]("new");
  assert.equal((await pages[1]).text, "new");
  answers[0]("old");
  assert.equal(await pages[0], null);
  answers[2]("newest");
  assert.equal((await pages[2]).text, "newest");
});

test("the screen is kept on as long as that is wanted and the page is seen, and where a browser refuses that, it is not", async () => {
  const page = Object.assign(new EventTarget(), { hidden: false });
  const [on, requests] = [new Set(), []];
  const sentinel = () => {
    const lock = { release: () => on.delete(lock) };
    return on.add(lock) && lock;
  };
  const request = () => new Promise((resolve, reject) => requests.push({ grant: () => resolve(sentinel()), refuse: reject }));
  const lock = new ScreenLock(/** @type {any} */ ({ page, request }));
  const see = (hidden) => {
    page.hidden = hidden;
    page.dispatchEvent(new Event("visibilitychange"));
  };
  const answered = async (how) => (requests.shift()[how](), await settle(), on.size);
  lock.keep(true);
  assert.equal(await answered("grant"), 1);
  see(true);
  assert.deepEqual([on.size, requests.length], [0, 0]);
  see(false);
  assert.equal(await answered("refuse"), 0);
  see(false);
  lock.keep(false);
  assert.equal(await answered("grant"), 0, "it came too late");
});

const NOW = Date.parse("2026-01-01T12:00:00Z");
const at = (ms) => new Date(NOW + ms).toISOString();

test("a machine whose clock is wrong counts as the server does", () => {
  let now = NOW + 3_600_000;
  const clock = new ServerClock(() => now);
  clock.receive(new Date(NOW).toUTCString());
  assert.equal(clock.secondsUntil(at(20_000)), 20);
  now += 10_000;
  assert.equal(clock.secondsUntil(at(20_000)), 10);
});

const MINUTE = 60_000;

function make() {
  const made = { clock: 1000, asked: 0, answer: Promise.resolve() };
  made.use = new LoginUse({ ask: () => (made.asked++, made.answer), now: () => made.clock });
  return made;
}

test("a page that is used asks once in five minutes, and one that nobody touches never", () => {
  const made = make();
  const page = new EventTarget();
  made.use.watch(page);
  page.dispatchEvent(new Event("keydown"));
  assert.equal(made.asked, 0, "the page has just been loaded");
  for (const [count, name] of ["pointerdown", "keydown", "wheel"].entries()) {
    made.clock += 5 * MINUTE;
    page.dispatchEvent(new Event("pointermove"));
    assert.equal(made.asked, count);
    for (let i = 0; i < 3; i++) page.dispatchEvent(new Event(name));
    assert.equal(made.asked, count + 1);
  }
});

for (const [name, before, after, moves] of [
  ["what stays is not moved, so that focus and choices stay with it", "abc", "bc", 0],
  ["what is new is put in its place", "bc", "ubcd", 2],
  ["what goes to the end moves alone", "abcd", "bcda", 1],
  ["a list that is turned around is in order", "abcd", "dcba", 3],
]) {
  test(`rows: ${name}`, () => {
    const container = new FakeElement();
    const rows = new KeyedRows({ container, keyOf: String, make: () => new FakeElement(), fill: (row, item) => (row.textContent = item) });
    rows.show([...before]);
    const elements = new Map(rows.elements);
    mock.method(container, "insertBefore");
    rows.show([...after]);
    assert.equal(container.children.map(({ textContent }) => textContent).join(""), after);
    assert.equal(container.insertBefore.mock.callCount(), moves);
    for (const [item, row] of rows.elements) assert.ok(!elements.has(item) || elements.get(item) === row);
  });
}

describe("presses", () => {
  // As much of the document as presses see: what an element is, and which control it is part of.
  const element = (control, selectors = []) => {
    const closest = (selector) => (selectors.some((one) => selector.includes(one)) ? (control ?? made) : null);
    const made = Object.assign(new FakeElement(), { closest, matches: () => false });
    return made;
  };
  const button = () => element(undefined, ["button"]);

  function page() {
    const listeners = {};
    new Presses().watch({ addEventListener: (name, act) => (listeners[name] = act) });
    const fire = (name, more) => {
      const event = { detail: 1, isTrusted: true, ignored: false, ...more };
      event.preventDefault = event.stopImmediatePropagation = () => (event.ignored = true);
      listeners[name](event);
      return !event.ignored;
    };
    return { down: (target) => fire("pointerdown", { target }), click: (target, more) => fire("click", { target, ...more }), fire };
  }

  const TARGETS = {
    plain: element(null),
    drive: button(),
    leave: button(),
    stop: element(undefined, ["button", ".stop"]),
    field: element(undefined, ["input"]),
  };
  TARGETS.icon = element(TARGETS.drive, ["button"]); // a part of it
  TARGETS.label = Object.assign(element(undefined, ["label"]), { control: TARGETS.field });

  // Where presses began, one after the other, and whether a click there counts.
  for (const [name, downs, target, counts, more] of [
    ["a press counts on the control on which it began", ["drive"], "drive", true],
    ["also from a part of it", ["icon"], "drive", true],
    ["a control that appears under the finger takes nothing", ["drive"], "leave", false],
    ["nor does one beside which the press began", ["drive", "plain"], "leave", false],
    ["a press anew counts", ["drive", "plain", "leave"], "leave", true],
    ["what is not a control passes", ["drive"], "plain", true],
    ["so does a click of a key or of assistive technology", ["drive"], "leave", true, { detail: 0 }],
    ["so does one of a script", ["drive"], "leave", true, { isTrusted: false }],
    ["a label's press counts on its field", ["label"], "field", true],
    ["Stop acts whatever the press began on", ["drive"], "stop", true],
  ]) {
    test(name, () => {
      const { down, click } = page();
      for (const place of downs) down(TARGETS[place]);
      assert.equal(click(TARGETS[target], more), counts);
    });
  }

  test("a second finger elsewhere leaves the first one's press as it is", () => {
    const { fire, click } = page();
    const { drive, leave } = TARGETS;
    fire("pointerdown", { target: drive, pointerId: 1, isPrimary: true });
    fire("pointerdown", { target: leave, pointerId: 2, isPrimary: false });
    assert.deepEqual([click(drive, { pointerId: 1 }), click(drive, { pointerId: 2 })], [true, false]);
  });

  test("a second finger, of which browsers make no click, presses what it was put on, if that takes clicks", () => {
    const { fire } = page();
    const { drive, leave, stop, plain } = TARGETS;
    const disabled = Object.assign(button(), { matches: () => true });
    globalThis.PointerEvent = /** @type {any} */ (Event);
    const clicks = (began, lies = began, type = "touch") => {
      const clicked = [];
      const note = ({ target }) => clicked.push(target);
      for (const one of [began, lies]) one.addEventListener("click", note, { once: true });
      globalThis.document = /** @type {any} */ ({ elementFromPoint: () => lies });
      fire("pointerdown", { target: began, pointerId: 2, isPrimary: false });
      fire("pointerup", { target: began, pointerId: 2, isPrimary: false, pointerType: type });
      for (const one of [began, lies]) one.removeEventListener("click", note);
      return clicked;
    };
    assert.deepEqual([clicks(drive), clicks(drive, leave), clicks(disabled), clicks(plain)], [[drive], [], [], []]);
    assert.deepEqual([clicks(stop, plain), clicks(drive, drive, "mouse")], [[stop], []]);
    drive.setAttribute("aria-disabled", "true");
    assert.deepEqual(clicks(drive), []);
    drive.removeAttribute("aria-disabled");
  });

  // What lies there at the second of two presses, at which place and time, and whether it gets that one.
  for (const [name, first, second, place, counts] of [
    ["a control that takes the place of another", "drive", "leave", { clientX: 105, timeStamp: 1300 }, false],
    ["the same control", "drive", "drive", { clientX: 105, timeStamp: 1300 }, true],
    ["a control beside it", "drive", "leave", { clientX: 130, timeStamp: 1300 }, true],
    ["one that is pressed later", "drive", "leave", { clientX: 105, timeStamp: 1600 }, true],
    ["one where no control was", "plain", "leave", { clientX: 105, timeStamp: 1300 }, true],
  ]) {
    test(`${name} gets ${counts ? "the" : "no"} second press`, () => {
      const { fire, click } = page();
      fire("pointerdown", { target: TARGETS[first], isPrimary: true, clientX: 100, clientY: 50, timeStamp: 1000 });
      fire("pointerdown", { target: TARGETS[second], isPrimary: true, clientX: 100, clientY: 50, ...place });
      assert.equal(click(TARGETS[second]), counts);
    });
  }

  test("a key that is held presses nothing that gets the focus meanwhile", () => {
    const pressed = (code, repeat) => page().fire("keydown", { code, repeat, target: button() });
    assert.deepEqual([pressed("Enter", false), pressed("Enter", true), pressed("KeyW", true)], [true, false, true]);
  });

  test("a page that was just opened takes no second press of a double one, and what a key does", (context) => {
    context.mock.timers.enable({ apis: ["setTimeout"] });
    const { down, click } = page();
    const asks = button();
    markOpened(asks);
    const acts = (detail) => (down(asks), click(asks, { detail }));
    assert.deepEqual([acts(1), acts(0)], [false, true]);
    context.mock.timers.tick(500);
    assert.equal(acts(1), true);
  });

  test("what is under way or done is not asked for again, and what failed is", async () => {
    const asked = [];
    const ask = (ok) => askOnce("a", async () => (asked.push(ok), { ok }));
    assert.deepEqual(await Promise.all([ask(false), ask(true)]), [{ ok: false }, null]);
    assert.deepEqual([await ask(true), await ask(true), asked], [{ ok: true }, null, [false, true]]);
  });

  test("a form that changes something is not sent twice by a double press", () => {
    let submit = /** @type {(event: object) => void} */ (() => {});
    sendOnce({ addEventListener: (_, listener) => (submit = listener) });
    const sends = (form, timeStamp, defaultPrevented = false) => {
      const event = { target: form, timeStamp, defaultPrevented, isSent: true, preventDefault: () => (event.isSent = false) };
      submit(event);
      return event.isSent;
    };
    const formOf = (method) => ({ getAttribute: () => method });
    const [post, get] = [formOf("post"), formOf("get")];
    assert.deepEqual([sends(post, 0, true), sends(post, 0), sends(post, 100), sends(formOf("post"), 100)], [true, true, false, true]);
    assert.deepEqual([sends(get, 0), sends(get, 100)], [true, true]);
    assert.equal(sends(post, 3000), true, "its answer did not come");
  });
});
