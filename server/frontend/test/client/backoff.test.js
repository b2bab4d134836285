import assert from "node:assert/strict";
import { test } from "node:test";

import { backoff } from "../../src/client/backoff.js";

const first = (count, random) => {
  const delays = backoff(random);
  return Array.from({ length: count }, () => delays.next().value);
};

test("delays double from half a second and stay at five seconds", () => {
  assert.deepEqual(
    first(6, () => 1),
    [500, 1000, 2000, 4000, 5000, 5000],
  );
});

test("jitter takes off at most half and never goes below half a second", () => {
  assert.deepEqual(
    first(6, () => 0),
    [500, 500, 1000, 2000, 2500, 2500],
  );
});
