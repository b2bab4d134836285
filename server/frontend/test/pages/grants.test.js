import assert from "node:assert/strict";
import { test } from "node:test";

import { USUAL_ENDS } from "../../src/pages/grants.js";

process.env.TZ = "Atlantic/Azores";

test("the usual ends are in the reader's own time, and seven days are so over a change of clocks", () => {
  assert.deepEqual(Object.fromEntries(USUAL_ENDS.map(([words, end]) => [words, end(new Date("2026-03-25T12:03:59Z"))])), {
    "1 h": "2026-03-25T12:03",
    Today: "2026-03-25T23:59",
    "7 days": "2026-04-01T11:03",
    "No end": "",
  });
});
