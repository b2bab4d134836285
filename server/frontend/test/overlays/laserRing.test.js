import assert from "node:assert/strict";
import { test } from "node:test";

import { ringPoints } from "../../src/overlays/laserRing.js";

test("what is ahead is up and what is at the left is left, as far as three metres, and what is near is said", () => {
  assert.deepEqual(ringPoints(Float32Array.from([1.5, 0, 0, 3, -0.75, 0, 3, 3])), [
    { x: 0, y: -0.5, near: false },
    { x: -1, y: 0, near: false },
    { x: 0, y: 0.25, near: true },
  ]);
});
