// What the supervisor's page says of figures, also over time, and of operators. Pure. Unknown is "-".

import { localTime } from "../dom/page.js";
import { requests as requestTexts, supervise as texts } from "../texts/queue.js";
import { ageText, reasonText } from "./requestRows.js";

const countText = (count) => (Number.isFinite(count) ? String(count) : requestTexts.unknown);

// By the part that each goes into; `figures` as of GET /api/v1/requests/figures.
export function figureTexts({ open, oldest_open_s: oldest, waiting_p50_s: p50, waiting_p95_s: p95, answered }) {
  return { open: countText(open), oldest: ageText(oldest), p50: ageText(p50), p95: ageText(p95), answered: countText(answered) };
}

const COUNTS = ["made", "closed", "cancelled"];
const WAITS = ["waiting_p50_s", "waiting_p95_s"];

// Charts as of health/charts.js; `periods` as of GET /api/v1/requests/periods.
export function chartsOf(periods) {
  const line = (name) => ({ name, values: periods.map((period) => period[name]) });
  return {
    times: periods.map(({ begins_at: at }) => Date.parse(at) / 1000),
    charts: [
      { name: "requests", title: texts.charts.requests, unit: "count", lines: COUNTS.map(line) },
      { name: "waits", title: texts.charts.waits, unit: "seconds", lines: WAITS.map(line), none: texts.noWaits },
    ],
  };
}

// A line of these charts in words.
export function periodWords({ name, values }, unit) {
  const known = values.filter(Number.isFinite);
  if (!known.length) return texts.lines[name](requestTexts.unknown, requestTexts.unknown);
  const [all, most] = [known.reduce((sum, value) => sum + value, 0), Math.max(...known)];
  const words = texts.lines[name](...(unit === "count" ? [all, most] : [ageText(most)]));
  return unit === "count" && known.length < values.length ? words + texts.partly(values.length - known.length) : words;
}

export function operatorFacts({ user, state, since, request, pools }) {
  return {
    user,
    "operator-state": texts.operatorStates[state] ?? requestTexts.unknown,
    since: localTime(since) || requestTexts.unknown,
    request: request ? texts.worksOn(request.robot, reasonText(request)) : requestTexts.unknown,
    pools: pools?.length ? pools.join(", ") : requestTexts.unknown,
  };
}

// Whom a request can be assigned to, those who are available first: the server refuses who is away or busy.
export function offeredOperators(operators) {
  const available = ({ state }) => Number(state === "available");
  return [...operators]
    .filter(({ state }) => state === "available" || state === "wrap_up")
    .sort((a, b) => available(b) - available(a))
    .map(({ user, state }) => ({ name: user, words: state === "available" ? user : texts.option(user, texts.operatorStates[state]) }));
}
