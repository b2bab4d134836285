// Battery and diagnostics of the robot, small beside the picture.

import { part, setText } from "../pages/page.js";
import { battery as batteryTexts, diagnostics as texts } from "../texts/video.js";
import { BatteryReader } from "./battery.js";
import { Diagnostics } from "./diagnostics.js";

const BATTERY_THROTTLE_MS = 2000;
const BATTERY_OLD_MS = 60_000;
const MOST_ROWS = 60;
// Each node sends its own part: what is held back must wait and not be lost.
const DIAGNOSTICS = { throttleMs: 100, queueLength: 50 };

export class Overlays {
  // `subscribe` as of connection.js.
  constructor(root, { subscribe, now }) {
    Object.assign(this, { subscribe, now });
    this.battery = part(root, "battery");
    this.details = part(root, "diagnostics");
    this.diagnostics = new Diagnostics();
    this.reader = new BatteryReader();
    this.follows = {};
    this.details.addEventListener("toggle", () => this.show());
  }

  // {battery, diagnostics}, each {name, type} or undefined.
  follow({ battery, diagnostics }) {
    this.listen("battery", battery, { throttleMs: BATTERY_THROTTLE_MS }, (message) => this.receiveBattery(message));
    this.listen("diagnostics", diagnostics, DIAGNOSTICS, (message) => this.diagnostics.receive(message, this.now()));
  }

  listen(kind, topic, limits, handler) {
    const key = topic ? `${topic.name} ${topic.type}` : "";
    if (key === (this.follows[kind]?.key ?? "")) return;
    this.follows[kind]?.end();
    this.follows[kind] = topic && { key, end: this.subscribe({ ...topic, ...limits }, handler) };
  }

  receiveBattery(message) {
    this.received = { battery: this.reader.read(message), at: this.now() };
    this.show();
  }

  // Called now and then, as what is silent grows old.
  show() {
    this.showBattery();
    this.showDiagnostics();
  }

  showBattery() {
    const fresh = this.received && this.now() - this.received.at < BATTERY_OLD_MS;
    const battery = fresh ? this.received.battery : null;
    this.battery.hidden = !battery;
    this.battery.dataset.low = String(Boolean(battery?.low));
    setText(this.battery, battery ? batteryTexts.level(battery) : "");
  }

  showDiagnostics() {
    const worst = this.diagnostics.worst(this.now());
    this.details.hidden = !worst;
    if (!worst) return;
    this.details.dataset.level = worst.level;
    setText(part(this.details, "diagnostics-worst"), texts[worst.level](worst.count));
    if (this.details.open) this.showList();
  }

  showList() {
    const list = this.diagnostics.list(this.now()).slice(0, MOST_ROWS);
    const shownList = JSON.stringify(list);
    if (shownList === this.shownList) return;
    this.shownList = shownList;
    part(this.details, "diagnostics-list").replaceChildren(...list.map(row));
  }
}

function row({ name, level, message }) {
  const item = document.createElement("li");
  item.dataset.level = level;
  const title = document.createElement("strong");
  title.textContent = `${texts.levels[level]}: ${name}`;
  item.append(title, ` ${message}`);
  return item;
}
