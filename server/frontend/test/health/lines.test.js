import assert from "node:assert/strict";
import { test } from "node:test";

import { lineText } from "../../src/health/lines.js";

test("a line says what is known of it, and what is not is no 0", () => {
  assert.equal(
    lineText({ name: "p99", values: [0.05, null, 0.2, null] }, "seconds"),
    "99 % within: now unknown, lowest 50 ms, highest 200 ms, unknown for 50 % of the time",
  );
  assert.equal(lineText({ name: "", values: [3, 0] }, "count"), "now 0, lowest 0, highest 3");
  assert.equal(lineText({ name: "", values: [15.4, 0, 0.3] }, "count"), "now 1, lowest 0, highest 15");
  assert.equal(lineText({ name: "lost", values: [null, null] }, "count"), "driver lost: unknown for all of this time");
});
