import assert from "node:assert/strict";
import { test } from "node:test";

import { keyTarget, share } from "../../src/replay/timeline.js";

test("keys lead along the line; up and down do on the slider alone", () => {
  const to = (key, more = {}) => keyTarget({ key, ...more }, 20_000, 60_000);
  assert.deepEqual(
    ["ArrowLeft", "ArrowRight", "Home", "End"].map((key) => to(key)),
    [15_000, 25_000, 0, 60_000],
  );
  assert.deepEqual([to("ArrowRight", { shiftKey: true }), to("ArrowUp"), to("a")], [21_000, undefined, undefined]);
  assert.equal(to("ArrowUp", { target: { type: "range" } }), 25_000);
});

test("no span leaves the line", () => {
  assert.deepEqual(share({ fromMs: 250, toMs: 500 }, 1000), { from: 0.25, width: 0.25 });
  assert.deepEqual(share({ fromMs: -1e12, toMs: 1e18 }, 1000), { from: 0, width: 1 });
  assert.deepEqual(share({ fromMs: 0, toMs: 0 }, 0), { from: 0, width: 0 });
});
