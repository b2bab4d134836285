import assert from "node:assert/strict";
import { test } from "node:test";

import { part } from "../../src/overlays/hud.js";

test("a speed is drawn as a part of the greatest, and never over the edge", () => {
  assert.equal(part(0.5, 1), 0.5);
  assert.equal(part(-3, 1.5), -1);
  assert.equal(part(undefined, 1), 0);
  assert.equal(part(NaN, 1), 0);
});
