import assert from "node:assert/strict";
import { test } from "node:test";

import { appsIn, isDrawn, lineLook, stateWords, topicsIn } from "../../src/pages/routes.js";

test("only what can be a topic with its type is offered, by name", () => {
  const answer = { topics: ["/b", "/a", "/c d", 7], types: ["t/B", "t/A", "t/C", "t/D"] };
  assert.deepEqual(topicsIn(answer), [
    { topic: "/a", type: "t/A" },
    { topic: "/b", type: "t/B" },
  ]);
  assert.equal(topicsIn({ topics: ["/a"], types: [] }), null);
  assert.equal(topicsIn(undefined), null);
});

test("what nobody measured is not claimed", () => {
  assert.equal(stateWords(undefined), "Not known");
  assert.deepEqual(lineLook(undefined), { state: "unknown", rate: "" });
  assert.equal(stateWords({ state: "elsewhere", rate_hz: null, why: "" }), "Not on this machine; another one may know its state");
  assert.equal(stateWords({ state: "runs", rate_hz: 0, why: "" }), "Runs, 0/s");
  assert.equal(stateWords({ state: "waits", rate_hz: 0, why: "sim1 is offline" }), "Waits: sim1 is offline");
});

test("another user's route leads to no app of this one", () => {
  const route = { source: "app:joy", target: "sim1" };
  assert.equal(isDrawn(route), false);
  assert.equal(isDrawn({ ...route, mine: "" }), true);
  assert.equal(isDrawn({ source: "sim1", target: "sim2" }), true);
});

test("an app shows with the machine that has it, and of two with one name this machine's", () => {
  const app = (name, machine) => ({ name, machine, advertises: [], subscribes: [] });
  const shown = appsIn([app("joy", null), app("joy", "b"), app("pad", "b")], [{ source: "sim1", target: "app:away" }]);
  assert.deepEqual(
    [...shown].map(([name, topics]) => [name, topics && topics.machine]),
    [
      ["app:away", null],
      ["app:joy", null],
      ["app:pad", "b"],
    ],
  );
});
