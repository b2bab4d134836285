// Recording the robot from the drive page, in its drawer: who records it, and a button that begins or stops that. What the page says
// to everybody while the robot is recorded is in drive.js. It must never touch what drives.

import { robotPath } from "../client/api.js";
import { localTime, part, setText } from "../dom/page.js";
import { isNew, markNew } from "../dom/presses.js";
import { recording as texts } from "../texts/panels.js";
import { refusal } from "./stopping.js";

const AGAIN_MS = 2000; // delay before the next look at one that is about to begin or end
const WHILE_MS = 30_000; // and at one that goes on: its end changes no robot object while another records the robot
const LISTED = 100; // as the server looks back: recordings by the robot's settings may be newer than one that a person asked for

/** @typedef {{id: number, cause: string, state: string, asked_by: string | null, started_at: string | null}} Recording */

// The recording that a person asked for and that goes on, or is about to begin; null for none. Pure.
/** @param {Recording[]} recordings */
function recordingUnderWay(recordings) {
  return recordings.find(({ cause, state }) => cause === "asked" && ["recording", "requested"].includes(state)) ?? null;
}

export class RecordButton {
  // `api` as of client/api.js.
  constructor(root, { robot, mac, me, level, api }) {
    this.root = root;
    this.mac = mac;
    this.beginPath = robotPath(robot, "recordings", { mac });
    this.mayStop = ({ asked_by: asker }) => level === "manage" || asker === me;
    this.api = api;
    this.round = 0;
    /** @type {boolean | undefined} */
    this.recorded = undefined; // whether anything records the robot, as the robot object says
    /** @type {Recording | null | undefined} */
    this.underWay = undefined; // null for none, undefined for unknown
    this.button = part(root, "record");
    this.button.addEventListener("click", () => this.press());
  }

  // Comes with each robot object.
  receive(recorded) {
    if (recorded === this.recorded) return;
    this.recorded = recorded;
    this.problem = ""; // of a press before
    this.refresh();
  }

  // An answer to an earlier question counts no more, whenever it comes.
  async refresh() {
    clearTimeout(this.timer);
    const round = ++this.round;
    const { ok, status, body } = await this.api.get("/api/v1/recordings", { mac: this.mac, limit: LISTED });
    if (round !== this.round) return;
    this.underWay = ok ? recordingUnderWay(body.recordings) : undefined;
    this.ending &&= this.underWay !== null;
    this.show();
    const isUnheard = !ok && refusal(status, 1) === "unheard";
    const delayMs = this.delayMs(isUnheard);
    if (delayMs) this.timer = setTimeout(() => this.refresh(), delayMs);
  }

  delayMs(isUnheard) {
    if (isUnheard || this.isChanging) return AGAIN_MS;
    return this.underWay ? WHILE_MS : 0;
  }

  get isChanging() {
    return this.ending || this.underWay?.state === "requested";
  }

  async press() {
    if (this.pressed || isNew(this.button)) return;
    this.pressed = true;
    const { underWay } = this;
    const path = underWay ? `/api/v1/recordings/${underWay.id}/stop` : this.beginPath;
    const { ok, detail } = await this.api.post(path);
    this.pressed = false;
    this.ending = Boolean(ok && underWay);
    this.problem = ok ? "" : (underWay ? texts.notStopped : texts.notBegun)(detail);
    await this.refresh();
  }

  show() {
    const { button, underWay } = this;
    const words = underWay ? texts.stop : texts.begin;
    if (this.isShown && words !== button.textContent) markNew(button); // the second press of a double one would stop it
    this.isShown = true;
    setText(button, words);
    button.disabled = underWay === undefined || this.ending || (underWay !== null && !this.mayStop(underWay));
    setText(part(this.root, "record-state"), this.problem || this.words);
  }

  get words() {
    const { underWay } = this;
    if (underWay === undefined) return texts.unknown;
    if (!underWay) return this.recorded ? texts.bySettings : "";
    if (this.ending) return texts.ends;
    return underWay.state === "requested" ? texts.begins : texts.since(localTime(underWay.started_at), underWay.asked_by ?? "");
  }
}
