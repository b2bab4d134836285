// What is kept of a topic under a probe: the numbers of the last minute, and how often messages come. Pure.

const MINUTE_MS = 60_000;
const MOST = 600;
const RATE_MS = 10_000;

export class LastMinute {
  constructor() {
    this.points = [];
  }

  push(value, at) {
    if (!Number.isFinite(value)) return;
    this.points.push({ value, at });
    if (this.points.length > MOST) this.points.shift();
    this.prune(at);
  }

  prune(now) {
    while (this.points.length && now - this.points[0].at > MINUTE_MS) this.points.shift();
  }

  // {now, min, max}, or null without a value.
  extent(now) {
    this.prune(now);
    if (this.points.length === 0) return null;
    const values = this.points.map(({ value }) => value);
    return { now: values.at(-1), min: Math.min(...values), max: Math.max(...values) };
  }
}

export class Rate {
  constructor() {
    this.times = [];
    this.at = null;
  }

  mark(at) {
    this.at = at;
    this.times.push(at);
    while (at - this.times[0] > RATE_MS) this.times.shift();
  }

  // Messages a second, of those that came in the last 10 s; null before there are two.
  perSecond(now) {
    const recent = this.times.filter((at) => now - at <= RATE_MS);
    const span = recent.at(-1) - recent[0];
    return span > 0 ? (1000 * (recent.length - 1)) / span : null;
  }

  silenceMs(now) {
    return this.at === null ? null : now - this.at;
  }
}

// A number as people read one: with the digits that count.
export function shortNumber(value) {
  if (!Number.isFinite(value)) return "-";
  const size = Math.abs(value);
  if (size >= 1e9 || (value !== 0 && size < 1e-3)) return value.toExponential(2);
  return size >= 1000 ? String(Math.round(value)) : String(Number(value.toPrecision(3)));
}

/** @type {[string, number][]} */
const UNITS = [
  ["GB", 1e9],
  ["MB", 1e6],
  ["KB", 1e3],
];

export function sizeText(bytes) {
  const [unit, one] = UNITS.find(([, least]) => bytes >= least) ?? ["bytes", 1];
  return `${one === 1 ? bytes : (bytes / one).toPrecision(bytes >= 100 * one ? 3 : 2)} ${unit}`;
}
