/*!
 * With uPlot, which has this licence:
 * The MIT License (MIT). Copyright (c) 2022 Leon Sorokin.
 * Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated documentation files
 * (the "Software"), to deal in the Software without restriction, including without limitation the rights to use, copy, modify, merge,
 * publish, distribute, sublicense, and/or sell copies of the Software, and to permit persons to whom the Software is furnished to do
 * so, subject to the following conditions: The above copyright notice and this permission notice shall be included in all copies or
 * substantial portions of the Software. THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING
 * BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
 * AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
 * OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
 */

// Draws charts with uPlot, on the pages Health and Supervise. Each has its lines in words beside it, which say the same.

import uPlot from "uplot";

import { make } from "../dom/page.js";
import { history as texts } from "../texts/health.js";
import { lineText, markText, valueText } from "./lines.js";

const HEIGHT = 160;
// As in health.css.
const COLOURS = ["--accent", "--bad", "--wait", "--good"];
// Distances of the marks of an axis of counts, which has no halves.
const COUNT_STEPS = [1, 10, 100, 1e3, 1e4, 1e5, 1e6].flatMap((step) => [step, 2 * step, 5 * step]);
const DASHES = [[], [8, 4], [2, 3], [8, 3, 2, 3]];

// `answer` is as that of /api/v1/health/history, `wordsOf(line, unit)` says a line; a chart's `none` is
// said where nothing of it is known. Gives what ends them.
export function drawCharts(container, answer, range, wordsOf = lineText) {
  const charts = answer.charts.map((chart) => draw(chart, answer.times, range, wordsOf));
  container.replaceChildren(...charts.map(({ figure }) => figure));
  const fit = () => charts.forEach(({ plot, place }) => plot?.setSize({ width: place.clientWidth, height: HEIGHT }));
  const observer = new ResizeObserver(fit);
  observer.observe(container);
  return () => {
    observer.disconnect();
    for (const { plot } of charts) plot?.destroy();
  };
}

function draw({ name, title: words = texts.titles[name] ?? name, unit, lines: all, none = texts.noData }, times, range, wordsOf) {
  const lines = all.some(({ values }) => values.some(Number.isFinite)) ? all : [];
  const items = lines.map((line) => make("li", {}, wordsOf(line, unit)));
  const place = make("div", { class: "plot", "aria-hidden": "true" });
  const title = make("h3", {}, words);
  const said = items.length ? make("ul", {}, ...items) : make("p", { class: "soft" }, none);
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
    ...(range === "month" && { tzDate: (seconds) => uPlot.tzDate(new Date(seconds * 1000), "Etc/UTC") }),
    scales: { y: { range: (_, __, most) => [0, most > 0 ? most * 1.1 : unit === "bits_per_s" ? 1e6 : 1] } },
    axes: [
      { ...axis, values: (_, marks) => marks.map((mark) => markText(mark, range)) },
      {
        ...axis,
        size: 76,
        ...(unit === "count" && { incrs: COUNT_STEPS }),
        values: (_, marks) => marks.map((mark) => valueText(mark, unit)),
      },
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
