import assert from "node:assert/strict";
import { test } from "node:test";

import { latencyBreakdown } from "../../src/overlays/readings.js";

test("what is left of the round trip is the robot's rosbridge", () => {
  assert.deepEqual(latencyBreakdown({ total: 60, server: 12, robot: 40 }), { server: 12, robot: 40, rosbridge: 8 });
});

test("nothing takes less than no time, though the parts are measured apart", () => {
  assert.equal(latencyBreakdown({ total: 50, server: 12, robot: 40 }).rosbridge, 0);
});

test("what is not known leaves the rest unknown", () => {
  assert.deepEqual(latencyBreakdown({ total: 60, server: null, robot: 40 }), { server: null, robot: 40, rosbridge: null });
});
