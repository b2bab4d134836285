import assert from "node:assert/strict";
import { test } from "node:test";

import { filterOf, fromQuery, inOrder, inWindow, isFiltered, sitesOf, toQuery } from "../../src/fleet/filters.js";

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

test("what is asked for stands in the address and comes back out of it", () => {
  const filter = { words: "sim lab", site: "north yard", states: ["online", "driven"], sort: "battery", down: true };
  const query = toQuery(filter);
  assert.equal(query, "?q=sim+lab&site=north+yard&show=online,driven&sort=-battery");
  assert.deepEqual(fromQuery(query), filter);
  assert.equal(toQuery(USUAL), "");
  assert.deepEqual(fromQuery(toQuery({ ...USUAL, site: "" })).site, "");
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

test("only what narrows is a filter", () => {
  assert.equal(isFiltered({ ...USUAL, words: "  ", sort: "name" }), false);
  assert.equal(isFiltered({ ...USUAL, site: "" }), true);
  assert.equal(isFiltered({ ...USUAL, states: ["online"] }), true);
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

test("sites are told once, none of them last", () => {
  assert.deepEqual(sitesOf([...FLEET, { site: "lab" }, { site: undefined }]), ["lab", "yard", ""]);
});

test("the first of a long list show, and how many follow", () => {
  const fits = (name) => name !== "sim2";
  assert.deepEqual(inWindow(["sim1", "sim2", "sim3", "sim4"], fits, 2), { shown: new Set(["sim1", "sim3"]), left: 1 });
  assert.deepEqual(inWindow(["sim1", "sim2"], fits, 2), { shown: new Set(["sim1"]), left: 0 });
});
