import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import { FleetStops, managedSites, outcome } from "../../src/fleet/fleetStops.js";

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

let before;

beforeEach(() => {
  before = globalThis.document;
  globalThis.document = { createElement: () => ({ setAttribute() {}, append() {} }) };
});

afterEach(() => {
  globalThis.document = before;
});

test("a robot that was released is no longer among those that a stop has stopped", () => {
  const result = { querySelector: () => null, replaceChildren: (...children) => (result.children = children) };
  const stops = new FleetStops({ querySelector: () => result }, { manages: true });
  const robot = (name, stopped) => ({ name, control: { stopped } });
  stops.results = ["sim1", "sim2"].map((name) => ({ name, stopped: true, confirmed: false }));
  const names = () => stops.results.map(({ name }) => name);
  stops.receive([robot("sim1", null), robot("sim2", { confirmed: true })]);
  assert.deepEqual(names(), ["sim1", "sim2"]); // the news of a stop may come after its answer
  stops.receive([robot("sim1", { confirmed: true }), robot("sim2", null)]);
  assert.deepEqual(names(), ["sim1"]);
  stops.receive([robot("sim1", null)]);
  assert.deepEqual([names(), result.children], [[], []]);
});
