import assert from "node:assert/strict";
import { test } from "node:test";

import { nearestOf, showNearest } from "../../src/fleet/nearest.js";

globalThis.document = { createElement: () => ({}) };

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

test("the machine that is nearer is named with both times, and linked", async () => {
  const links = [];
  const element = { dataset: { machines: JSON.stringify([a, b]) }, textContent: "", append: (_, link) => links.push(link) };
  const times = { "": 95.4, "https://a.example": null, "https://b.example:8443": 0.4 };
  await showNearest(element, async (origin) => times[origin]);
  assert.equal(element.textContent, "Machine b is nearer to you: 1 ms, this one 95 ms.");
  assert.deepEqual(links, [{ href: "https://b.example:8443/", textContent: "Open b" }]);
});
