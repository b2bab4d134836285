import assert from "node:assert/strict";
import { test } from "node:test";

import { requestFacts, stateText } from "../../src/queue/requestRows.js";
import { chartsOf, figureTexts, offeredOperators, operatorFacts, periodWords } from "../../src/queue/supervision.js";

const REQUEST = {
  id: 7,
  robot: "sim1",
  reason: "<b>stuck</b>",
  source: "page",
  priority: 1,
  pool: "hall",
  asked_by: "ann",
  age_s: 125.4,
  state: "offered",
  offered_to: "ben",
};

test("a request is written as it is known, and what is not known is -", () => {
  assert.deepEqual(requestFacts(REQUEST), {
    robot: "sim1",
    reason: "<b>stuck</b>",
    priority: "Urgent",
    pool: "hall",
    asker: "ann",
    age: "2 min 5 s",
    state: "Offered to ben",
  });
  const unknown = { ...REQUEST, reason: "", source: "battery", priority: 9, pool: "", asked_by: null, age_s: null, state: "new" };
  const { reason, priority, pool, asker, age, state } = requestFacts(unknown);
  assert.deepEqual([reason, priority, pool, asker, age, state], ["Battery low", "-", "Any", "-", "-", "-"]);
});

for (const [state, view, words] of [
  ["available", { ahead: 0 }, "You are available. You are next."],
  ["available", { ahead: 2 }, "You are available. 2 operators are before you."],
  ["available", { ahead: null }, "You are available."],
  ["busy", { current: REQUEST }, "You are busy with sim1."],
  ["", null, "It is not known whether you are available."],
]) {
  test(`an operator reads: ${words}`, () => assert.equal(stateText(state, view), words));
}

test("figures and operators that are not known are -", () => {
  const figures = { open: 0, oldest_open_s: null, waiting_p50_s: 10.6, waiting_p95_s: 63, answered: 12 };
  assert.deepEqual(figureTexts(figures), { open: "0", oldest: "-", p50: "11 s", p95: "1 min 3 s", answered: "12" });
  const away = { user: "ben", state: "away", since: null, request: null, pools: [] };
  assert.deepEqual(operatorFacts(away), { user: "ben", "operator-state": "Away", since: "-", request: "-", pools: "-" });
});

test("figures over time are said in words, and what is unknown is no 0", () => {
  const begins_at = "2026-11-29T01:00:00Z";
  const unknown = { begins_at, made: null, closed: null, cancelled: null, waiting_p50_s: null, waiting_p95_s: null };
  const known = { begins_at, made: 3, closed: 2, cancelled: 0, waiting_p50_s: 20, waiting_p95_s: 125 };
  const { times, charts } = chartsOf([unknown, known, { ...known, made: 1, waiting_p95_s: null }]);
  assert.deepEqual(times, [1795914000, 1795914000, 1795914000]);
  assert.deepEqual(
    charts.flatMap(({ lines, unit }) => lines.map((line) => periodWords(line, unit))),
    [
      "Asked: 4 in all, at most 3; unknown for the first 1",
      "Done: 4 in all, at most 2; unknown for the first 1",
      "Cancelled: 0 in all, at most 0; unknown for the first 1",
      "Half within: at most 20 s",
      "95 % within: at most 2 min 5 s",
    ],
  );
  assert.equal(periodWords({ name: "made", values: [null] }, "count"), "Asked: - in all, at most -");
});

test("a request can be assigned to who is available, then to who wraps up", () => {
  const operators = ["busy", "wrap_up", "away", "available"].map((state) => ({ user: `is-${state}`, state }));
  assert.deepEqual(
    offeredOperators(operators).map(({ words }) => words),
    ["is-available", "is-wrap_up (Wrap-up)"],
  );
});
