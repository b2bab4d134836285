// How old is what the driver sees: the age that the robot's guard measures, about where that time goes, and how slow the robot is
// for it.
// It must never show an age that nobody measured: what is not reported is unknown.

import { byTestId, part, setText } from "../dom/page.js";
import { limits, seen as texts } from "../texts/common.js";

/** @typedef {import("../client/session.js").Seen} Seen */

const TICK_MS = 250;
const SHOWN_MS = 2000; // time for which a report counts; the guard reports each half second
const DRIVES_MS = 1000; // time after a command that moves the robot for which the driver counts as driving

export class SeenAge {
  constructor(root, { now = () => performance.now() } = {}) {
    this.element = byTestId(root, "seen-age");
    this.parts = byTestId(root, "seen-parts");
    this.now = now;
    /** @type {(Seen & {at: number}) | null} */
    this.report = null;
    this.begunAt = this.drivenAt = -Infinity;
    this.oldest = null;
    setInterval(() => this.show(), TICK_MS);
  }

  // A command goes to the robot, of an input at `timestamp`; `frames` as of Tiles.seenAt, null where there is no camera.
  /** @type {(frames: import("../client/shownFrames.js").ShownFrame[] | null, timestamp: number) => void} */
  command(frames, timestamp) {
    const [oldest = null] = [...(frames ?? [])].sort((one, other) => one.at - other.at);
    this.oldest = oldest && { videoMs: oldest.shownAt - oldest.at, heldMs: Math.max(0, timestamp - oldest.shownAt) };
    if (!frames) return;
    const now = this.now();
    if (now - this.drivenAt > DRIVES_MS) this.begunAt = now;
    this.drivenAt = now;
  }

  /** @type {(seen: Seen) => void} */
  receive(seen) {
    this.report = { ...seen, at: this.now() };
    this.show();
  }

  show() {
    const ageMs = this.shownMs;
    this.element.hidden = ageMs === undefined;
    if (ageMs === undefined) return;
    const { slowed } = this;
    this.element.dataset.slowed = String(Boolean(slowed));
    const ago = texts.ago(ageMs === null ? texts.unknown : Math.round(ageMs));
    setText(part(this.element, "value"), slowed ? `${slowed}: ${ago}` : ago);
    const words = this.words(ageMs);
    this.element.title = words;
    setText(this.parts, words);
  }

  // To what the robot slows the driver's commands, in words; empty for not at all.
  get slowed() {
    const { maxSpeed = null, maxTurn = null } = this.isFresh ? (this.report ?? {}) : {};
    const words = [maxSpeed !== null && limits.linear(maxSpeed), maxTurn !== null && limits.angular(maxTurn)];
    return words.some(Boolean) ? texts.slowed(...words) : "";
  }

  get isFresh() {
    return this.report !== null && this.now() - this.report.at <= SHOWN_MS;
  }

  // The age to show; null for unknown, undefined for none: nobody drives, or the first report is still to come.
  get shownMs() {
    const now = this.now();
    if (this.report && this.isFresh) return this.report.ageMs;
    const drives = now - this.drivenAt <= DRIVES_MS && now - this.begunAt > SHOWN_MS;
    return drives ? null : undefined;
  }

  words(ageMs) {
    if (ageMs === null) return texts.why;
    if (!this.oldest) return "";
    const { videoMs, heldMs } = this.oldest;
    return texts.parts(...[videoMs, heldMs, Math.max(0, ageMs - videoMs - heldMs)].map(Math.round));
  }
}
