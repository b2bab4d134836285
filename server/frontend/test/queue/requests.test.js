import assert from "node:assert/strict";
import { test } from "node:test";

import { requestFacts, stateText } from "../../src/queue/requestRows.js";
import { chartsOf, figureTexts, operatorFacts, periodWords } from "../../src/queue/supervision.js";

test("what is not known of a request or of an operator is said to be", () => {
  const unknown = { robot: "sim1", reason: "", source: "battery", priority: 9, pool: "", asked_by: null, age_s: null, state: "new" };
  const { reason, priority, pool, asker, age, state } = requestFacts(unknown);
  assert.deepEqual([reason, priority, pool, asker, age, state], ["Battery low", "-", "Any", "-", "-", "-"]);
  assert.equal(stateText("", null), "It is not known whether you are available.");
});

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
  const { charts } = chartsOf([unknown, known, { ...known, made: 1, waiting_p95_s: null }]);
  const said = charts.flatMap(({ lines, unit }) => lines.map((line) => periodWords(line, unit)));
  assert.equal(said[0], "Asked: 4 in all, at most 3; unknown for the first 1");
  assert.equal(said[2], "Cancelled: 0 in all, at most 0; unknown for the first 1");
  assert.equal(said[4], "95 % within: at most 2 min 5 s");
  assert.equal(periodWords({ name: "made", values: [null] }, "count"), "Asked: - in all, at most -");
});
