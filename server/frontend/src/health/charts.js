// Draws the charts of the page Health with uPlot. Each has its lines in words beside it, which say the same.

import uPlot from "uplot";

import { make } from "../dom/page.js";
import { history as texts } from "../texts/health.js";
import { lineText, markText, valueText } from "./lines.js";

const HEIGHT = 160;
// As in health.css.
const COLOURS = ["--accent", "--bad", "--wait", "--good"];
const DASHES = [[], [8, 4], [2, 3], [8, 3, 2, 3]];

// `answer` is that of /api/v1/health/history. Gives what ends them.
export function drawCharts(container, answer, range) {
  const charts = answer.charts.map((chart) => draw(chart, answer.times, range));
  container.replaceChildren(...charts.map(({ figure }) => figure));
  const fit = () => charts.forEach(({ plot, place }) => plot?.setSize({ width: place.clientWidth, height: HEIGHT }));
  const observer = new ResizeObserver(fit);
  observer.observe(container);
  return () => {
    observer.disconnect();
    for (const { plot } of charts) plot?.destroy();
  };
}

function draw({ name, unit, lines }, times, range) {
  const words = lines.map((line) => make("li", {}, lineText(line, unit)));
  const place = make("div", { class: "plot", "aria-hidden": "true" });
  const title = make("h3", {}, texts.titles[name] ?? name);
  const said = words.length ? make("ul", {}, ...words) : make("p", { class: "soft" }, texts.noData);
  const figure = make("figure", { class: "chart", "data-testid": `chart-${name}` }, make("figcaption", {}, title, said), place);
  const data = /** @type {uPlot.AlignedData} */ ([times, ...lines.map(({ values }) => values)]);
  return { figure, place, plot: lines.length ? new uPlot(options(unit, lines, range), data, place) : null };
}

/** @returns {uPlot.Options} */
function options(unit, lines, range) {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
  return {
    width: 320,
    height: HEIGHT,
    legend: { show: false },
    cursor: { show: false },
    scales: { y: { range: (_, __, most) => [0, most > 0 ? most * 1.1 : 1] } },
    axes: [
      { ...axis, values: (_, marks) => marks.map((mark) => markText(mark, range)) },
      { ...axis, size: 76, values: (_, marks) => marks.map((mark) => valueText(mark, unit)) },
    ],
    series: [
      {},
      ...lines.map((_, index) => ({
        stroke: colour(COLOURS[index % COLOURS.length]),
        dash: DASHES[index % DASHES.length],
        width: 2,
        spanGaps: false,
      })),
    ],
  };
}
