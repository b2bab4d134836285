import assert from "node:assert/strict";
import { test } from "node:test";

import { Choices, LocalStore, asksForKeys, shortNumber, sizeText } from "../../src/dom/page.js";

// As the browser's, in memory.
function storage() {
  const values = new Map();
  return {
    values,
    getItem: (name) => values.get(name) ?? null,
    setItem: (name, value) => values.set(name, value),
    removeItem: (name) => values.delete(name),
  };
}

test("a question mark asks for the keys, but not with a modifier and not in a text", () => {
  const inText = { closest: (selector) => (selector.includes("textarea") ? {} : null) };
  const onPage = { closest: () => null };
  assert.ok(asksForKeys({ key: "?", target: onPage }));
  assert.ok(asksForKeys({ key: "?", shiftKey: true, target: onPage }));
  assert.ok(!asksForKeys({ key: "?", target: inText }));
  assert.ok(!asksForKeys({ key: "?", ctrlKey: true, target: onPage }));
  assert.ok(!asksForKeys({ key: "/", target: onPage }));
});

test("what is written is read again, and forgotten when asked", () => {
  const store = storage();
  const kept = new LocalStore(() => store);
  kept.write("sticks", true);
  assert.equal(new LocalStore(() => store).read("sticks"), true);
  kept.forget("sticks");
  assert.equal(kept.read("sticks"), null);
});

test("what is no JSON, and what was never written, is nothing", () => {
  const store = storage();
  store.values.set("robotether.sticks", "{");
  const kept = new LocalStore(() => store);
  assert.equal(kept.read("sticks"), null);
  assert.equal(kept.read("other"), null);
});

test("a browser that keeps nothing is no error", () => {
  const kept = new LocalStore(() => {
    throw new Error("blocked");
  });
  kept.write("sticks", true);
  kept.forget("sticks");
  assert.equal(kept.read("sticks"), null);
});

test("choices are those of their name, nonsense is none, and what is chosen anew leaves the others", () => {
  const store = storage();
  const choices = (name) => new Choices(name, new LocalStore(() => store));
  store.values.set("robotether.sight.sim2", "7");
  choices("sight.sim1").keep({ quality: "50" });
  choices("sight.sim1").keep({ laser: true });
  assert.deepEqual(choices("sight.sim1").all, { quality: "50", laser: true });
  assert.deepEqual([choices("sight.sim2").all, choices("sight.sim3").all], [{}, {}]);
});

test("numbers are short and still tell small from none", () => {
  assert.deepEqual([0, 0.12345, -1.5, 123456.7, 0.0001234, 2.5e12, NaN].map(shortNumber), [
    "0",
    "0.123",
    "-1.5",
    "123457",
    "1.23e-4",
    "2.50e+12",
    "-",
  ]);
});

test("sizes are told in the unit that people know", () => {
  assert.deepEqual([12, 1500, 250_000, 1_230_000].map(sizeText), ["12 bytes", "1.5 KB", "250 KB", "1.2 MB"]);
});
