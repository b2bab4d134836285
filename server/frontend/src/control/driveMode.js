// Whether this page drives its robot or watches it, and what a person can do about that. Pure.
// It must never take the control unless the person asked for it on this page, nor by a mere press of a driving key while
// somebody drives, in another window of this person's included, and never arm the controls when control comes at a
// time that the person does not choose.

import { LocalStore } from "../dom/page.js";

const OF_A_STOP = ["robot_stopped", "stopped_meanwhile"]; // notes that its release ends
/** @typedef {import("../client/session.js").Control} Control */

/** @type {Control} */
const NOTHING = { driver: null, waiting: null, reserved: null, stopped: null, guard: "unknown" };

export class DriveMode {
  // `me` is the user's name, `level` observe, drive or manage. `onMove()` asks for a connection of the mode
  // that counts from now on, `onChange()` reports all else. `drove` is the drive mode's `saved` of before a reload, or null.
  /** @param {{me: string, level: string, drove?: {armed: boolean} | null, onMove: () => void, onChange?: () => void}} options */
  constructor({ me, level, drove = null, onMove, onChange = () => {} }) {
    this.me = me;
    this.level = level;
    this.onMove = onMove;
    this.onChange = onChange;
    this.mayDrive = level !== "observe";
    this.mode = this.mayDrive && drove ? "drive" : "observe";
    this.armed = Boolean(this.driving && drove?.armed);
    this.pressed = false; // a press took the control, which is on its way
    this.known = false; // whether the control object has come
    /** @type {"sent" | "waiting" | null} */
    this.asked = null;
    // What last changed the drive mode; with `busy`, why a press did not.
    /** @type {{why: string, by?: string, reason?: string, busy?: boolean} | null} */
    this.note = null;
    this.handedTo = ""; // whom this person lets have the control, until it has gone
    this.wasStopped = false; // whether a stop ended this page's drive, and still holds
    this.control = NOTHING;
  }

  get driving() {
    return this.mode === "drive";
  }

  // What a reload of this page begins with.
  get saved() {
    return this.driving ? { armed: this.armed } : null;
  }

  /** @param {Partial<Control>} control */
  receive(control) {
    const before = this.control;
    this.control = { ...NOTHING, ...control };
    this.known = true;
    if (!this.control.stopped) this.wasStopped = false;
    if (this.outlives(before)) this.note = null;
    if (this.asked) this.followQuestion();
    this.onChange();
  }

  // Whether the note is about a state that has ended.
  outlives(before) {
    if (this.note?.busy) return this.note.why !== this.busy;
    const released = before.stopped && !this.control.stopped;
    return released && OF_A_STOP.includes(this.note?.why ?? "");
  }

  // The server ended the connection or did not let it drive; `why` as `lost` in connection.js.
  lose(why, reason) {
    this.mode = "observe";
    this.armed = this.pressed = false;
    this.note = why === "lease_lost" && this.handedTo ? { why: "handed_over", by: this.handedTo } : { why, reason };
    this.handedTo = "";
    this.wasStopped = why === "robot_stopped";
    this.onChange();
  }

  // The connection stands, or will not for now: what was pressed meanwhile has driven on, or must be pressed anew.
  settle() {
    this.pressed = false;
  }

  // A driving key, stick or enable button was pressed on a page that watches. Gives whether that takes the control.
  press() {
    if (this.driving) return this.pressed;
    if (!this.known || this.asked) return false;
    if (this.busy) this.setNote({ why: this.busy, by: this.other?.user, busy: true });
    else this.drive("pressed");
    return this.pressed;
  }

  // Who drives, or is about to.
  get other() {
    return this.control.driver ?? this.control.reserved;
  }

  // Why a press does not take the control; empty when it does.
  get busy() {
    const { driver, reserved, stopped } = this.control;
    if (stopped) return "busy_stopped";
    if (driver) return driver.user === this.me ? "busy_window" : "busy_driver";
    return reserved && reserved.user !== this.me ? "busy_reserved" : "";
  }

  // Whether a press would take the control, or has taken it.
  get free() {
    return this.pressed || (this.mayDrive && !this.driving && this.known && !this.asked && !this.busy);
  }

  // A person took the control by the button, or by a press of what drives.
  /** @param {string | null} why */
  drive(why = null) {
    this.pressed = why === "pressed";
    this.startDriving({ armed: true, why });
  }

  // A person held the release button. If that person drove when the robot was stopped, and has read so, they drive again; else the
  // control is free.
  released(again) {
    if (again) this.drive("released");
    else this.setNote({ why: "released" });
  }

  // Nothing is reported to this page any more.
  end() {
    Object.assign(this, { control: NOTHING, known: false, asked: null, note: null });
    this.onChange();
  }

  leave() {
    this.mode = "observe";
    this.armed = this.pressed = false;
    this.note = { why: "left" };
    this.onMove();
    this.onChange();
  }

  arm() {
    this.armed = true;
    this.note = null;
    this.onChange();
  }

  // The server may have the question already: of before a reload, or its answer was lost.
  ask() {
    this.asked = this.control.waiting?.user === this.me ? "waiting" : "sent";
    this.note = null;
    this.onChange();
  }

  // Whoever asks again at once must not take the end of this question for a refusal.
  withdraw() {
    this.control = { ...this.control, waiting: null };
    this.forget();
  }

  // The question is over from this side: withdrawn, or not taken by the server.
  forget(note = /** @type {DriveMode["note"]} */ (null)) {
    this.endQuestion(note);
    this.onChange();
  }

  setNote(note) {
    this.note = note;
    this.onChange();
  }

  followQuestion() {
    const { driver, waiting, reserved, stopped } = this.control;
    if (waiting?.user === this.me) this.asked = "waiting";
    else if (stopped) this.endQuestion({ why: "stopped_meanwhile" });
    else if (reserved?.user === this.me) this.startDriving({ armed: false, why: "arrived" });
    else if (this.asked === "waiting") this.unanswered(driver, reserved);
  }

  // What was asked no longer stands, and control did not come.
  unanswered(driver, reserved) {
    if (!driver && !reserved) this.startDriving({ armed: false, why: "arrived" });
    else if (driver && driver.user !== this.me) this.endQuestion({ why: "refused", by: driver.user });
    else this.endQuestion(null);
  }

  endQuestion(note) {
    this.asked = null;
    this.note = note;
  }

  /** @param {{armed: boolean, why?: string | null}} how */
  startDriving({ armed, why = null }) {
    this.mode = "drive";
    this.armed = armed;
    this.handedTo = "";
    this.wasStopped = false;
    this.endQuestion(why && { why });
    this.onMove();
    this.onChange();
  }

  // Who asks the person at this page for the control, or null.
  get asking() {
    const { driver, waiting } = this.control;
    return this.driving && driver?.user === this.me ? waiting : null;
  }

  // The names of what can be done now; `live` says whether the connection stands, `waits` as of connection.js.
  actions(live, waits = false) {
    if (this.driving) return this.driverActions(live, waits);
    if (!this.mayDrive || !live || this.control.stopped) return [];
    if (this.asked) return ["withdraw", ...this.takeActions()];
    return [...this.askActions(), ...this.takeActions()];
  }

  // A page that waits would take the control again, as soon as the robot is back.
  driverActions(live, waits) {
    if (!live) return waits ? ["leave"] : [];
    return this.armed ? ["leave"] : ["arm", "leave"];
  }

  askActions() {
    if (!this.known) return [];
    const { driver, waiting } = this.control;
    const { other } = this;
    if (!other || other.user === this.me) return ["drive"];
    return driver && (!waiting || waiting.user === this.me) ? ["ask"] : [];
  }

  takeActions() {
    const { driver } = this.control;
    return this.level === "manage" && driver && driver.user !== this.me ? ["take"] : [];
  }
}

// Lets a reload of the page go on driving, and Drive on the fleet page begin it. It is saved when the page goes and believed
// once, soon after and in the same tab: a page that is opened otherwise, by a link from elsewhere too, another tab of the
// same person, one that is duplicated or comes back later must not take the control by that.
const GOOD_MS = 10_000;
const AGAIN = ["reload", "back_forward"];

export class ReloadStore {
  // `mac` is the robot's: another one may have its name by the time that the page is there.
  constructor(mac, { store = new LocalStore(() => globalThis.sessionStorage), arrival = arrived, now = () => Date.now() } = {}) {
    this.store = store;
    this.arrival = arrival;
    this.now = now;
    this.name = `drove ${mac}`;
  }

  // `drove` is `saved` of DriveMode, or null when the page did not drive; with `asked` where a person pressed Drive.
  save(drove) {
    if (drove) this.store.write(this.name, { ...drove, at: this.now() });
  }

  // Gives it, or null.
  restore() {
    const drove = this.store.read(this.name);
    this.store.forget(this.name);
    if (!drove || !(AGAIN.includes(this.arrival()) || drove.asked)) return null;
    return Math.abs(this.now() - drove.at) < GOOD_MS ? drove : null;
  }
}

// How the browser came to this page.
const arrived = () => /** @type {PerformanceNavigationTiming} */ (performance.getEntriesByType("navigation")[0])?.type;
