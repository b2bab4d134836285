import assert from "node:assert/strict";
import { test } from "node:test";

import { LocalStore } from "../../src/pages/page.js";

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
