import assert from "node:assert/strict";
import { test } from "node:test";

import { nearestOf } from "../../src/fleet/nearest.js";

const [a, b] = [
  { name: "a", authority: "a.example" },
  { name: "b", authority: "b.example:8443" },
];

const CASES = [
  [95, [70, 18], b],
  [95, [null, 18], b],
  [20, [15, 1], {}], // 19 ms less
  [200, [170, 161], {}], // less than a fifth
  [100, [80, 90], a],
  [95, [null, null], {}],
  [null, [5, 5], {}],
];
for (const [here, others, expected] of CASES) {
  test(`with ${here} ms here and ${others} ms elsewhere, ${expected.name ?? "no machine"} is nearer`, () => {
    assert.deepEqual(nearestOf(here, [a, b], others).machine ?? {}, expected);
  });
}
