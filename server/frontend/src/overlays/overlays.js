// Battery and diagnostics of the robot, beside the video. The battery is what the server says, as on the fleet page.

import { make, part, setText } from "../dom/page.js";
import { battery as batteryTexts, diagnostics as texts } from "../texts/video.js";
import { batteryText, chargeHealth } from "./battery.js";
import { Subscriptions } from "./subscriptions.js";

const MAX_ROWS = 60;
// Each node sends its own part: what is held back must wait and not be lost.
const DIAGNOSTICS = { throttleMs: 100, queueLength: 50 };

export class Overlays {
  // `subscribe` as of connection.js.
  constructor(root, { subscribe, now }) {
    this.subscriptions = new Subscriptions(subscribe);
    this.now = now;
    this.battery = part(root, "battery");
    this.details = part(root, "diagnostics");
    this.diagnostics = new Diagnostics();
    this.details.addEventListener("toggle", () => this.show());
  }

  // {diagnostics}, {name, type} or undefined.
  /** @param {{diagnostics?: {name: string, type: string}}} topics */
  follow({ diagnostics }) {
    this.subscriptions.follow("diagnostics", diagnostics, DIAGNOSTICS, (message) => this.diagnostics.receive(message, this.now()));
  }

  // What was read is another robot's.
  forget() {
    this.diagnostics = new Diagnostics();
    this.show();
  }

  // A robot of the feed's.
  showBattery(robot) {
    this.battery.dataset.health = chargeHealth(robot);
    setText(this.battery, batteryText(robot) || batteryTexts.none);
  }

  // Called now and then, as what is silent grows old.
  show() {
    const worst = this.diagnostics.worst(this.now());
    this.details.hidden = !worst;
    if (!worst) return;
    this.details.dataset.level = worst.level;
    const words = texts[worst.level](worst.count);
    setText(part(this.details, "diagnostics-worst"), this.diagnostics.isCut ? texts.newest(words, MAX_NAMES) : words);
    if (this.details.open) this.showList();
  }

  showList() {
    const all = this.diagnostics.list(this.now());
    const list = all.slice(0, MAX_ROWS);
    const left = all.length - list.length;
    const shownList = JSON.stringify([list, left]);
    if (shownList === this.shownList) return;
    this.shownList = shownList;
    const more = left ? [make("li", {}, texts.more(left))] : [];
    part(this.details, "diagnostics-list").replaceChildren(...list.map(row), ...more);
  }
}

function row({ name, level, message }) {
  return make("li", { "data-level": level }, make("strong", {}, `${texts.levels[level]}: ${name}`), ` ${message}`);
}

// The robot's diagnostics (REP-107): the newest of each name, and the worst of all. Pure.
const LEVELS = ["ok", "warn", "error", "stale"];

// From what needs no look to what does: of what is stale nothing is known.
const ORDER = ["ok", "warn", "stale", "error"];
const STALE_MS = 10_000;
const MAX_NAMES = 500;

export class Diagnostics {
  constructor() {
    this.byName = new Map();
    this.isCut = false; // whether names were left out
  }

  // `message` is a diagnostic_msgs/DiagnosticArray.
  receive({ status }, now) {
    for (const entry of Array.isArray(status) ? status : []) {
      const { name, level, message } = entry ?? {};
      if (typeof name !== "string") continue;
      this.byName.delete(name);
      this.byName.set(name, { name, level: readLevel(level), message: String(message ?? ""), at: now });
      // The newest stay: names may change without end, and an error must not be missed.
      if (this.byName.size <= MAX_NAMES) continue;
      this.isCut = true;
      this.byName.delete(this.byName.keys().next().value);
    }
  }

  // [{name, level, message}], the worst first.
  list(now) {
    const current = ({ name, level, message, at }) => ({ name, level: now - at > STALE_MS ? "stale" : level, message });
    return [...this.byName.values()]
      .map(current)
      .sort((a, b) => ORDER.indexOf(b.level) - ORDER.indexOf(a.level) || a.name.localeCompare(b.name));
  }

  // {level, count} of the worst level that there is, or null before the first message.
  worst(now) {
    const all = this.list(now);
    if (all.length === 0) return null;
    const [{ level }] = all;
    return { level, count: all.filter((entry) => entry.level === level).length };
  }
}

// A `byte`: a number, or as some bridges write bytes, base64 or the character itself. What cannot be read is not known.
export function readLevel(level) {
  const value = typeof level === "string" ? fromText(level) : level;
  return LEVELS[value] ?? "stale";
}

function fromText(text) {
  if (/^\d$/.test(text)) return Number(text);
  if (text.length === 1) return text.charCodeAt(0);
  return /^[A-Za-z0-9+/]{2}==$/.test(text) ? atob(text).charCodeAt(0) : undefined;
}
