// The page Health: each part now, and charts of the last hour, day or week. Loaded by admin/health.html.

import { api, LoginUse } from "../dom/calls.js";
import { KeyedRows, madeBy } from "../dom/keyedRows.js";
import { byTestId, noteScript, part, setText } from "../dom/page.js";
import { drawCharts } from "../health/charts.js";
import { Poller, tickWhileSeen } from "../queue/poller.js";
import { showDataState } from "../queue/requestRows.js";
import { health as texts, history as historyTexts } from "../texts/health.js";

// Intervals between two questions for what is now, and for the history.
const NOW_EVERY_MS = 10_000;
const HISTORY_EVERY_MS = 60_000;

const main = /** @type {HTMLElement} */ (document.querySelector("main"));
const charts = part(main, "charts");
const robot = byTestId(main, "health-robot");
const rangeButtons = /** @type {HTMLElement[]} */ ([...main.querySelectorAll("[data-range]")]);
let endCharts = () => {};
let range = "hour";
let round = 0;
let historyAt = -Infinity; // when it was asked for

const parts = new KeyedRows({
  container: byTestId(main, "health-parts").tBodies[0],
  keyOf: ({ name }) => name,
  make: madeBy("part-row"),
  fill: (row, { name, state, words, advice }) => {
    const facts = { name, state: texts.states[state], words, advice: advice || texts.nothingToDo };
    for (const [place, text] of Object.entries(facts)) setText(part(row, place), text);
    part(row, "state").dataset.state = state;
  },
});
const alerts = new KeyedRows({
  container: part(main, "alerts"),
  keyOf: ({ name, summary }) => `${name} ${summary}`,
  make: madeBy("alert-row"),
  fill: (row, { name, summary }) => {
    setText(part(row, "alert"), name);
    setText(part(row, "summary"), summary);
    part(row, "link").setAttribute("href", `/docs/howto/metrics/#${name.toLowerCase()}`);
    part(row, "link").setAttribute("aria-label", `What to do: ${name}`);
  },
});
const poller = new Poller({
  ask: () => api.get("/api/v1/health"),
  onAnswer: show,
  onState: (state) => showDataState(main, byTestId(main, "health-feed"), state),
  everyMs: NOW_EVERY_MS,
});

function show({ parts: all, alerts: lasting }) {
  parts.show(all);
  alerts.show(lasting ?? []);
  const { unknown, none, some } = texts.alerts;
  setText(part(main, "alerts-state"), lasting === null ? unknown : lasting.length ? some(lasting.length) : none);
}

async function showHistory() {
  const asked = ++round;
  historyAt = Date.now();
  charts.dataset.stale = "true";
  const query = robot.value ? { range, robot: robot.value } : { range };
  const { ok, code, detail, body } = await api.get("/api/v1/health/history", query);
  if (asked !== round) return; // somebody has chosen something else since
  endCharts();
  endCharts = () => {};
  charts.replaceChildren();
  charts.dataset.stale = "false";
  if (ok) {
    endCharts = drawCharts(charts, body, range);
    setText(part(main, "history-state"), historyTexts.of(robot.value, historyTexts.ranges[range]));
  } else setText(part(main, "history-state"), code === "history_unavailable" ? historyTexts.needsProfile : historyTexts.failed(detail));
}

for (const button of rangeButtons) {
  button.addEventListener("click", () => {
    range = String(button.dataset.range);
    for (const other of rangeButtons) other.setAttribute("aria-pressed", String(other === button));
    showHistory();
  });
}
robot.addEventListener("change", showHistory);
new LoginUse().watch(window);
noteScript();
setText(part(main, "history-state"), historyTexts.loading);
tickWhileSeen(() => {
  poller.tick();
  if (Math.abs(Date.now() - historyAt) >= HISTORY_EVERY_MS) showHistory(); // the clock may be set back
});
