import assert from "node:assert/strict";
import { test } from "node:test";

import { filterOf, fromQuery, inOrder } from "../../src/fleet/filters.js";

const USUAL = { words: "", site: null, states: [], sort: "state", down: false };
const FLEET = [
  { name: "sim2", online: false, site: "lab" },
  { name: "sim10", online: true, site: "yard", battery: { percent: 80 }, rtt_ms: 12, control: { driver: { user: "ann" } } },
  { name: "sim30", online: true, site: null, battery: { percent: 15, charging: false }, rtt_ms: 9, control: { stopped: { by: "ben" } } },
];
const names = (filter) => FLEET.filter(filterOf({ ...USUAL, ...filter })).map(({ name }) => name);

test("an address without a query shows all, as one with nonsense does", () => {
  assert.deepEqual(fromQuery(""), USUAL);
  assert.deepEqual(fromQuery("?show=flying&sort=colour"), USUAL);
});

test("each choice narrows what is shown", () => {
  assert.deepEqual(names({}), ["sim2", "sim10", "sim30"]);
  assert.deepEqual(names({ words: "SIM 1" }), ["sim10"]);
  assert.deepEqual(names({ words: "ann" }), ["sim10"]);
  assert.deepEqual(names({ words: "yard" }), ["sim10"]);
  assert.deepEqual(names({ site: "lab" }), ["sim2"]);
  assert.deepEqual(names({ site: "" }), ["sim30"]);
  assert.deepEqual(names({ states: ["online"] }), ["sim10", "sim30"]);
  assert.deepEqual(names({ states: ["online", "driven"] }), ["sim10"]);
  assert.deepEqual(names({ states: ["stopped"] }), ["sim30"]);
  assert.deepEqual(names({ states: ["attention"] }), ["sim2", "sim30"]);
  assert.deepEqual(names({ words: "ann", site: "lab" }), []);
  const waiting = { name: "new", online: false, state: "pending" };
  assert.equal(filterOf({ ...USUAL, states: ["attention"] })(waiting), true);
});

// Who has no value comes last, whichever way it is sorted, and equals by name.
for (const [sort, down, expected] of [
  ["state", false, ["sim10", "sim30", "sim2"]],
  ["state", true, ["sim2", "sim10", "sim30"]],
  ["battery", false, ["sim30", "sim10", "sim2"]],
  ["battery", true, ["sim10", "sim30", "sim2"]],
  ["rtt", false, ["sim30", "sim10", "sim2"]],
  ["site", false, ["sim2", "sim10", "sim30"]],
  ["driver", false, ["sim10", "sim2", "sim30"]],
  ["name", true, ["sim30", "sim10", "sim2"]],
]) {
  test(`sorted by ${sort}${down ? ", turned around" : ""}`, () => {
    const found = inOrder(FLEET, { sort, down }).map(({ name }) => name);
    assert.deepEqual(found, expected);
  });
}
