import assert from "node:assert/strict";
import { test } from "node:test";

import { managedSites, outcome } from "../../src/fleet/fleetStops.js";

test("only sites with a robot that is managed can be stopped, each once and in order", () => {
  const robots = [
    { site: "yard", level: "manage" },
    { site: "lab", level: "manage" },
    { site: "lab", level: "drive" },
    { site: "hall", level: "observe" },
    { site: null, level: "manage" },
    { site: "new", level: "" },
  ];
  assert.deepEqual(managedSites(robots), ["lab", "new", "yard"]);
});

test("what became of a stop follows the robot's own news", () => {
  const answer = { name: "sim1", stopped: true, confirmed: false };
  assert.match(outcome(answer, undefined), /not confirmed/);
  assert.match(outcome(answer, { stopped: { confirmed: false } }), /not confirmed/);
  assert.equal(outcome(answer, { stopped: { confirmed: true } }), "sim1: stopped");
  assert.match(outcome({ ...answer, stopped: false }, { stopped: null }), /not stopped/);
});
