// The numbers of the drive page: measured and commanded speed, how old speed and video are, round trip and its parts.

import { poseReader, speedReader } from "../client/rosbridge.js";
import { byTestId, part, setText } from "../pages/page.js";
import { readings as texts, dataAge, latency } from "../texts/common.js";
import { Subscriptions } from "./subscriptions.js";

const OLD_MS = 2500;
const TICK_MS = 250;

export class Readings {
  // `frameAge()` gives the age of the main frame in ms, null for none.
  constructor(root, { frameAge }) {
    this.root = root;
    this.frameAge = frameAge;
    this.speedAt = null;
    this.wayMs = 0;
    setInterval(() => this.tick(), TICK_MS);
  }

  speed(measured) {
    if (measured) this.speedAt = performance.now();
    this.value("speed-linear", measured ? decimals(measured.forward) : texts.none);
    this.value("speed-angular", measured ? decimals(measured.turn) : texts.none);
  }

  wanted({ forward, turn }) {
    this.write("wanted-linear", texts.wanted(decimals(forward)));
    this.write("wanted-angular", texts.wanted(decimals(turn)));
  }

  // `reading` as of rtt.js; `parts` are its known parts, {server, robot} in ms.
  rtt(reading, parts) {
    const old = reading && reading.ageMs > OLD_MS;
    this.value("rtt", reading ? String(Math.round(reading.medianMs)) : texts.none);
    this.wayMs = reading ? reading.medianMs / 2 : 0;
    this.showParts(reading && !old ? latencyBreakdown({ total: reading.medianMs, ...parts }) : null);
    setText(part(this.root, "rtt-age"), old ? texts.old(Math.round(reading.ageMs / 1000)) : "");
  }

  showParts(parts) {
    const element = byTestId(this.root, "rtt-parts");
    setText(part(element, "short"), parts ? latency.parts(rounded(parts)) : "");
    setText(part(element, "words"), parts ? latency.words(rounded(parts)) : "");
  }

  // A speed was on its way for a while before it came here.
  tick() {
    const frameAge = this.frameAge();
    const speed = this.speedAt === null ? null : performance.now() - this.speedAt + this.wayMs;
    this.value("picture-age", frameAge === null ? dataAge.none : dataAge.exact(Math.round(frameAge)));
    this.write("speed-age", speed === null ? "" : ageText(speed));
  }

  // The unit beside the value stands in the template.
  value(testId, text) {
    setText(part(byTestId(this.root, testId), "value"), text);
  }

  write(testId, text) {
    setText(byTestId(this.root, testId), text);
  }
}

// Two decimals, and no "-0.00" for a robot that stands still.
const decimals = (value) => (Math.abs(value) < 0.005 ? 0 : value).toFixed(2);

const ageText = (ms) => (ms < 10_000 ? dataAge.measured(Math.round(ms)) : dataAge.long(Math.round(ms / 1000)));

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
   *   onSpeed: (speed: {forward: number, left: number, turn: number} | null) => void,
   *   onPose?: (pose: {x: number, y: number, theta: number}) => void,
   * }} options
   */
  constructor({ subscribe, onSpeed, onPose = () => {} }) {
    this.subscriptions = new Subscriptions(subscribe);
    this.onSpeed = onSpeed;
    this.onPose = onPose;
  }

  // `topic` is {name, type}. Following the same one again changes nothing.
  follow(topic) {
    const [read, readPose] = [speedReader(topic.type), poseReader(topic.type)];
    const begun = this.subscriptions.follow("speed", topic, { throttleMs: THROTTLE_MS }, (message) => {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.forget(), SPEED_OLD_MS);
      this.onSpeed(read(message));
      if (readPose) this.onPose(readPose(message));
    });
    if (begun) this.forget();
  }

  forget() {
    clearTimeout(this.timer);
    this.onSpeed(null);
  }
}
