import assert from "node:assert/strict";
import { test } from "node:test";

import { split } from "../../src/truth/trip.js";

test("what is left of the round trip is the robot's rosbridge", () => {
  assert.deepEqual(split({ total: 60, server: 12, robot: 40 }), { server: 12, robot: 40, rosbridge: 8 });
});

test("nothing takes less than no time, though the parts are measured apart", () => {
  assert.equal(split({ total: 50, server: 12, robot: 40 }).rosbridge, 0);
});

test("what is not known leaves the rest unknown", () => {
  assert.deepEqual(split({ total: 60, server: null, robot: 40 }), { server: null, robot: 40, rosbridge: null });
});
