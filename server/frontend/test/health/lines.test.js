import assert from "node:assert/strict";
import { test } from "node:test";

import { lineText, valueText } from "../../src/health/lines.js";

test("a line says what is known of it, and what is not is no 0", () => {
  assert.equal(
    lineText({ name: "p99", values: [0.05, null, 0.2, null] }, "seconds"),
    "99 % within: now unknown, lowest 50 ms, highest 200 ms, unknown for 50 % of the time",
  );
  assert.equal(lineText({ name: "", values: [3, 0] }, "count"), "now 0, lowest 0, highest 3");
  assert.equal(lineText({ name: "", values: [15.4, 0, 0.3] }, "count"), "now 1, lowest 0, highest 15");
  assert.equal(lineText({ name: "lost", values: [null, null] }, "count"), "driver lost: unknown for all of this time");
});

test("a value has the unit that people read", () => {
  assert.deepEqual(
    [
      [0.05, "seconds"],
      [2, "seconds"],
      [2_500_000, "bits_per_s"],
      [30, "per_s"],
      [80, "percent"],
      [null, "count"],
    ].map(([value, unit]) => valueText(value, unit)),
    ["50 ms", "2 s", "2.5 Mbit/s", "30 /s", "80 %", "unknown"],
  );
});
