import assert from "node:assert/strict";
import { test } from "node:test";

import { recall, remember } from "../../src/video/memory.js";

function storage() {
  const kept = new Map();
  return { getItem: (key) => kept.get(key) ?? null, setItem: (key, value) => kept.set(key, value) };
}

test("each robot has its own memory", () => {
  const store = storage();
  remember("sim1", { quality: "50" }, store);
  assert.deepEqual(recall("sim1", store), { quality: "50" });
  assert.deepEqual(recall("sim2", store), {});
});

test("a browser that keeps nothing, or nonsense, is no error", () => {
  const broken = { getItem: () => "{", setItem: () => { throw new Error("full"); } };
  remember("sim1", {}, broken);
  assert.deepEqual(recall("sim1", broken), {});
  assert.deepEqual(recall("sim1", undefined), {});
  assert.deepEqual(recall("sim1", { getItem: () => "7" }), {});
});
