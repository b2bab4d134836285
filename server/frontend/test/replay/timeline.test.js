import assert from "node:assert/strict";
import { test } from "node:test";

import { share } from "../../src/replay/timeline.js";

test("no span leaves the line", () => {
  assert.deepEqual(share({ fromMs: 250, toMs: 500 }, 1000), { from: 0.25, width: 0.25 });
  assert.deepEqual(share({ fromMs: -1e12, toMs: 1e18 }, 1000), { from: 0, width: 1 });
  assert.deepEqual(share({ fromMs: 0, toMs: 0 }, 0), { from: 0, width: 0 });
});
