import assert from "node:assert/strict";
import { test } from "node:test";

import { nearestOf, showNearest } from "../../src/fleet/nearest.js";
import { FakeElement } from "../fakes.js";

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

// What each origin takes; one that is missing does not answer.
for (const [name, tookMs, words, href] of [
  [
    "a nearer machine has a link",
    { "": 95, "https://b.example:8443": 18 },
    /^Machine b is nearer to you: 18 ms, this one 95 ms/,
    "https://b.example:8443/",
  ],
  ["none is nearer", { "": 20, "https://a.example": 18 }, /^No machine that answers is clearly nearer .*\(20 ms\)/],
  ["without an answer of this one, it is not known", { "https://a.example": 18 }, /^It is not known/],
]) {
  test(`the fleet page says: ${name}`, async () => {
    const element = Object.assign(new FakeElement(), { dataset: { machines: JSON.stringify([a, b]) } });
    globalThis.document = /** @type {any} */ ({ createElement: () => new FakeElement() });
    await showNearest(element, async (origin) => tookMs[origin] ?? null);
    assert.match(element.textContent, words);
    assert.equal(element.children[1]?.href, href);
  });
}

test("the shortest of three round trips counts, and of a machine that falls silent the last that it answered", async (context) => {
  let clock = 0;
  const tookMs = [90, 20, 100];
  context.mock.method(performance, "now", () => clock);
  context.mock.method(globalThis, "fetch", async () => {
    if (!tookMs.length) throw new TypeError("no answer");
    clock += tookMs.shift() ?? 0;
  });
  const element = Object.assign(new FakeElement(), { dataset: { machines: "[]" } });
  for (const [rest, words] of /** @type {[number[], RegExp][]} */ ([
    [[90, 20, 100], /\(20 ms\)/],
    [[70], /\(70 ms\)/],
    [[], /^It is not known/],
  ])) {
    tookMs.splice(0, Infinity, ...rest);
    await showNearest(element);
    assert.match(element.textContent, words);
  }
});
