// The supervisor's page: what waits and how long, who does what, assigning by hand and closing, and figures over time. Loaded by
// supervise.html.

import { api, LoginUse } from "../dom/calls.js";
import { KeyedRows, madeBy } from "../dom/keyedRows.js";
import { byTestId, noteScript, part, reloadOnReturn, setText } from "../dom/page.js";
import { askOnce, Presses } from "../dom/presses.js";
import { drawCharts } from "../health/charts.js";
import { Poller, tickWhileSeen } from "../queue/poller.js";
import { endOf, fillRequest, keyOfRequest, showDataState } from "../queue/requestRows.js";
import { chartsOf, figureTexts, offeredOperators, operatorFacts, periodWords } from "../queue/supervision.js";
import { supervise as texts } from "../texts/queue.js";

// Intervals between two questions for what is now, and for the figures over time.
const EVERY_MS = 2000;
const PERIODS_EVERY_MS = 60_000;

const main = /** @type {HTMLElement} */ (document.querySelector("main"));
const feedState = byTestId(main, "supervise-feed");
const outcome = byTestId(main, "assign-outcome");
const newRow = madeBy("open-row");
const bodyOf = (testId) => byTestId(main, testId).tBodies[0];
const charts = part(main, "charts");
const periodButtons = /** @type {HTMLElement[]} */ ([...main.querySelectorAll("[data-by]")]);
/** @type {any[]} */
let operators = [];
let by = "hour"; // the length of the periods that the charts have
let endCharts = () => {};

const requests = new KeyedRows({
  container: bodyOf("open-requests"),
  keyOf: keyOfRequest,
  fill: fillRow,
  make: ({ id, robot }) => {
    const row = newRow();
    part(row, "operator").setAttribute("aria-label", texts.operatorFor(robot));
    part(row, "assign").setAttribute("aria-label", texts.assign(robot));
    part(row, "assign").addEventListener("click", () => assign(id, robot, part(row, "operator")));
    part(row, "close").setAttribute("aria-label", texts.close(robot));
    part(row, "close").addEventListener("click", () => close(id, robot, row.dataset.state));
    return row;
  },
});
const people = new KeyedRows({
  container: bodyOf("operators"),
  keyOf: ({ user }) => user,
  make: madeBy("operator-row"),
  fill: (row, operator) => {
    for (const [name, words] of Object.entries(operatorFacts(operator))) setText(part(row, name), words);
  },
});
const poller = new Poller({ ask, onAnswer: show, onState: (state) => showDataState(main, feedState, state), everyMs: EVERY_MS });
const periodPoller = new Poller({
  ask: () => api.get("/api/v1/requests/periods", { by }),
  onAnswer: showPeriods,
  onState: ({ name, detail }) => {
    charts.dataset.stale = String(name !== "live");
    if (name !== "live") setText(part(main, "periods-state"), texts.noPeriods(detail));
  },
  everyMs: PERIODS_EVERY_MS,
});

// All of it, or what failed first: half of a page that is new and half that is old would be taken for one.
async function ask() {
  const answers = await Promise.all([
    api.get("/api/v1/requests", { state: "open" }),
    api.get("/api/v1/operators"),
    api.get("/api/v1/requests/figures", { hours: 24 }),
  ]);
  const [open, staff, figures] = answers;
  return answers.find(({ ok }) => !ok) ?? { ok: true, body: { ...open.body, ...staff.body, figures: figures.body } };
}

function show({ requests: open, operators: staff, figures }) {
  operators = staff;
  for (const [name, words] of Object.entries(figureTexts(figures))) setText(part(main, name), words);
  requests.show(open);
  byTestId(main, "open-requests").hidden = open.length === 0;
  setText(part(main, "none"), open.length ? "" : texts.none);
  people.show(staff);
  byTestId(main, "operators").hidden = staff.length === 0;
  setText(part(main, "no-operator"), staff.length ? "" : texts.noOperator);
}

function showPeriods({ periods }) {
  endCharts();
  endCharts = drawCharts(charts, chartsOf(periods), by === "day" ? "month" : "day", periodWords);
  setText(part(main, "periods-state"), texts.periods[by]);
}

function choosePeriod(chosen) {
  by = String(chosen.dataset.by);
  for (const button of periodButtons) button.setAttribute("aria-pressed", String(button === chosen));
  periodPoller.askNow();
}

// The list of people is written anew only when it differs: one that is open would close.
function fillRow(row, request) {
  fillRequest(row, request);
  const select = part(row, "operator");
  const options = offeredOperators(operators);
  const written = options.map(({ words }) => words).join("\n");
  if (select.dataset.written === written) return;
  select.dataset.written = written;
  const { value } = select;
  select.replaceChildren(new Option(texts.choose, ""), ...options.map(({ name, words }) => new Option(words, name)));
  select.value = options.some(({ name }) => name === value) ? value : "";
}

async function assign(id, robot, select) {
  const user = select.value;
  if (!user) return setText(outcome, texts.chooseFirst(robot));
  const { ok, detail } = await api.post(`/api/v1/requests/${id}/assign`, { user });
  setText(outcome, ok ? texts.assigned(robot, user) : texts.failed(robot, detail));
  if (ok) select.value = "";
  poller.askNow();
}

async function close(id, robot, state) {
  const answer = await askOnce(id, () => api.post(`/api/v1/requests/${id}/${endOf({ state })}`, {}));
  if (!answer) return;
  setText(outcome, answer.ok ? texts.closed(robot) : texts.notClosed(robot, answer.detail));
  poller.askNow();
}

for (const button of periodButtons) button.addEventListener("click", () => choosePeriod(button));
new Presses().watch(window);
reloadOnReturn();
new LoginUse().watch(window);
noteScript();
tickWhileSeen(() => {
  poller.tick();
  periodPoller.tick();
});
