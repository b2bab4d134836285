import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { LoginUse, ServerClock } from "../../src/dom/calls.js";
import { KeyedRows } from "../../src/dom/keyedRows.js";
import { Choices, LocalStore, freshPage, shortNumber } from "../../src/dom/page.js";
import { FakeElement, storageOf } from "../fakes.js";

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

test("choices are those of their name, nonsense is none, and what is chosen anew leaves the others", () => {
  const store = storageOf(new Map([["robotether.sight.sim2", "7"]]));
  const choices = (name) => new Choices(name, new LocalStore(() => store));
  choices("sight.sim1").keep({ quality: "50" });
  choices("sight.sim1").keep({ laser: true });
  assert.deepEqual(choices("sight.sim1").all, { quality: "50", laser: true });
  assert.deepEqual([choices("sight.sim2").all, choices("sight.sim3").all], [{}, {}]);
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

test("a network that is cut disturbs nothing", async () => {
  const made = make();
  made.answer = Promise.reject(new TypeError("network"));
  made.clock += 5 * MINUTE;
  made.use.note();
  await new Promise(setImmediate);
  assert.equal(made.asked, 1);
});

for (const [name, before, after, moves] of [
  ["what stays is not moved, so that focus and choices stay with it", "abc", "bc", 0],
  ["what is new is put in its place", "bc", "ubcd", 2],
  ["what goes to the end moves alone", "abcd", "bcda", 1],
  ["what goes to the front moves alone", "abcd", "dabc", 1],
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
