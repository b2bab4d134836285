// The numbers of the drive page: speed as asked for and as measured, the age of the video, the round trip and its parts.

import { poseReader, speedReader } from "../client/rosbridge.js";
import { byTestId, decimalText, part, setIfOther, setText } from "../dom/page.js";
import { readings as texts, latency } from "../texts/common.js";
import { Subscriptions } from "./subscriptions.js";

const OLD_MS = 2500;
const TICK_MS = 250;
const MIN_MS_IN_SECONDS = 10_000;
// The greatest values, in ms, that are good and that are fair.
const LINK_MS = [100, 300];
const GOOD_FRAME_MS = 250;

export class Readings {
  // `frameAge()` gives the age of the main frame in ms, null for none; `limits` and `oldMs` as of settings.js.
  constructor(root, { frameAge, limits, oldMs }) {
    this.root = root;
    this.frameAge = frameAge;
    this.limits = { linear: limits.maxLinear, angular: limits.maxAngular };
    this.frameMs = [GOOD_FRAME_MS, oldMs];
    setInterval(() => this.tick(), TICK_MS);
  }

  // {forward, left, turn}, each null for unknown; null for all of them.
  speed(measured) {
    const { forward = null, left = null, turn = null } = measured ?? {};
    this.value("speed-linear", speedText(forward, left));
    this.value("speed-angular", degrees(turn));
    this.bar("linear", "measured", lengthOf(forward, left));
    this.bar("angular", "measured", turn);
  }

  wanted({ forward, left, turn }) {
    setText(byTestId(this.root, "wanted-linear"), texts.wanted(speedText(forward, left)));
    setText(byTestId(this.root, "wanted-angular"), texts.wanted(degrees(turn)));
    this.bar("linear", "asked", lengthOf(forward, left));
    this.bar("angular", "asked", turn);
  }

  // How much of the most it is: filled what is measured, a line at what is asked for. Nothing for what is not known.
  bar(name, kind, value) {
    const share = Math.min(1, Math.abs(value) / this.limits[name]);
    const bar = part(this.root, `bar-${name}`).querySelector(`.bar-${kind}`);
    bar.hidden = value === null;
    bar.style.transform = kind === "asked" ? `translateX(${share * 100}%)` : `scaleX(${share})`;
  }

  // `reading` as of rtt.js; `parts` are its known parts, {server, robot} in ms.
  rtt(reading, parts) {
    const old = reading && reading.ageMs > OLD_MS;
    const ms = reading ? Math.round(reading.medianMs) : null;
    this.time("rtt", ms, old ? "poor" : health(ms, LINK_MS));
    const breakdown = reading && !old ? latency.words(rounded(latencyBreakdown({ total: reading.medianMs, ...parts }))) : "";
    const words = old ? texts.old(Math.round(reading.ageMs / 1000)) : breakdown;
    setText(byTestId(this.root, "rtt-parts"), words);
    part(this.root, "rtt-help").title = words;
  }

  tick() {
    const age = this.frameAge();
    const ms = age === null ? null : Math.round(age);
    this.time("picture-age", ms, health(ms, this.frameMs));
  }

  // In milliseconds, or in seconds where those would be cut.
  time(testId, ms, health) {
    const inSeconds = ms !== null && ms >= MIN_MS_IN_SECONDS;
    setText(byTestId(this.root, testId).querySelector("small"), inSeconds ? "s" : "ms");
    this.value(testId, ms === null ? texts.none : String(inSeconds ? Math.floor(ms / 1000) : ms), health);
  }

  // The unit beside the value stands in the template.
  value(testId, text, health = "") {
    const element = byTestId(this.root, testId);
    setText(part(element, "value"), text);
    setIfOther(element.dataset, "health", health);
  }
}

// "good", "fair" or "poor" by the greatest values that are good and that are fair; empty for what is not known.
/** @type {(value: number | null, bounds: number[]) => string} */
export function health(value, [good, fair]) {
  if (value === null) return "";
  if (value <= good) return "good";
  return value <= fair ? "fair" : "poor";
}

const STILL_M_S = 0.005; // shown as 0.00
// Ahead, and on counter-clockwise in eighths of a turn.
const ARROWS = ["↑", "↖", "←", "↙", "↓", "↘", "→", "↗"];

const lengthOf = (forward, left) => (forward === null || left === null ? null : Math.hypot(forward, left));

// How fast, and in which direction as seen from the robot.
export function speedText(forward, left) {
  const length = lengthOf(forward, left);
  if (length === null) return texts.none;
  if (length < STILL_M_S) return (0).toFixed(2);
  const eighth = Math.round(Math.atan2(left, forward) / (Math.PI / 4));
  return `${ARROWS[(eighth + ARROWS.length) % ARROWS.length]} ${decimalText(length, 2)}`;
}

const degrees = (radians) => (radians === null ? texts.none : decimalText((radians * 180) / Math.PI, 0));

function rounded(parts) {
  const texts = Object.entries(parts).map(([name, ms]) => [name, Number.isFinite(ms) ? Math.round(ms) : latency.unknown]);
  return Object.fromEntries(texts);
}

// Where the time of a round trip goes. Pure.
// `total` from this page to the robot's rosbridge and back, `server` to the server, `robot` from there to the robot: ms,
// or null for what is not known. They are measured apart, so what is left for rosbridge is never shown as less than 0.
export function latencyBreakdown({ total, server, robot }) {
  const known = [total, server, robot].every((part) => Number.isFinite(part));
  return { server, robot, rosbridge: known ? Math.max(0, total - server - robot) : null };
}

// Reads speed and pose that the robot reports, and says nothing rather than something old.
const THROTTLE_MS = 100;
const SPEED_OLD_MS = 1000;

export class Readback {
  // `subscribe(spec, handler)` as of connection.js; `onSpeed` gets {forward, turn} or null for unknown,
  // `onPose` {x, y, theta} in the odometry's frame, with each message.
  /**
   * @param {{
   *   subscribe: (spec: object, handler: (message: any) => void) => () => void,
   *   onSpeed: (speed: {forward: number | null, left: number | null, turn: number | null} | null) => void,
   *   onPose?: (pose: {x: number, y: number, theta: number} | null) => void,
   * }} options
   */
  constructor({ subscribe, onSpeed, onPose = () => {} }) {
    this.subscriptions = new Subscriptions(subscribe);
    this.onSpeed = onSpeed;
    this.onPose = onPose;
  }

  // `topic` is {name, type}, or undefined for none. Following the same one again changes nothing.
  follow(topic) {
    const { type = "" } = topic ?? {};
    const [read, readPose] = [speedReader(type), poseReader(type)];
    const begun = this.subscriptions.follow("speed", topic, { throttleMs: THROTTLE_MS }, (message) => {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.forget(), SPEED_OLD_MS);
      this.onSpeed(read(message ?? {}));
      if (readPose) this.onPose(readPose(message ?? {}));
    });
    if (begun || !topic) this.forget();
  }

  forget() {
    clearTimeout(this.timer);
    this.onSpeed(null);
  }
}
