// What the page Health says of a line of a chart, in words. What is null is unknown, and never 0. Pure.

import { shortNumber } from "../dom/page.js";
import { history as texts } from "../texts/health.js";

// A value with its unit, as the API names it.
export function valueText(value, unit) {
  if (value === null || value === undefined) return "unknown";
  if (unit === "seconds" && value < 1) return texts.units.milliseconds(shortNumber(value * 1000));
  return texts.units[unit](shortNumber(unit === "bits_per_s" ? value / 1e6 : value));
}

// Prometheus extrapolates what it counted, to 15.4 log-ins; of a little of one there was one.
const wholeCount = (value) => (value > 0 ? Math.max(1, Math.round(value)) : value);

// One line in words: now, lowest, highest, and how much of the time is not known.
export function lineText({ name, values }, unit) {
  const whole = unit === "count" ? values.map(wholeCount) : values;
  const known = whole.filter((value) => value !== null);
  if (!known.length) return texts.noLine(texts.lines[name] ?? name);
  const [now, least, most] = [whole[whole.length - 1], Math.min(...known), Math.max(...known)].map((value) => valueText(value, unit));
  const percent = Math.ceil((100 * (values.length - known.length)) / values.length);
  return texts.line({ name: texts.lines[name] ?? name, now, least, most }) + (percent ? texts.gaps(percent) : "");
}

// The time of a mark below a chart.
export function markText(seconds, range) {
  const time = new Date(seconds * 1000);
  if (range === "month") return time.toLocaleDateString("en-GB", { day: "numeric", month: "short", timeZone: "UTC" });
  if (range === "week") return time.toLocaleDateString("en-GB", { weekday: "short", day: "numeric" });
  return time.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
}
