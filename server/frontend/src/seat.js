// Whether this page drives its robot or watches it, and what a person can do about that. Pure.
// It must never take the wheel unless the person asked for it on this page, and never arm the controls when
// control comes at a moment that the person does not choose.

const OF_A_STOP = ["robot_stopped", "stopped_meanwhile"]; // notes that its release ends
const NOTHING = { driver: null, waiting: null, reserved: null, stopped: null, guard: "unknown" };

export class Seat {
  // `me` is the user's name, `level` observe, drive or manage. `onMove()` asks for a connection of the mode
  // that counts from now on, `onChange()` tells of all else.
  constructor({ me, level, onMove, onChange = () => {} }) {
    Object.assign(this, { me, level, onMove, onChange });
    this.mayDrive = level !== "observe";
    this.mode = this.mayDrive ? "drive" : "observe";
    this.armed = true; // opening the page is a wish to drive
    this.asked = null; // "sent", "waiting"
    this.note = null; // {why, by}: what last changed the seat
    this.control = NOTHING;
  }

  get driving() {
    return this.mode === "drive";
  }

  hear(control) {
    const released = this.control.stopped && !control.stopped;
    if (released && OF_A_STOP.includes(this.note?.why)) this.note = null;
    this.control = { ...NOTHING, ...control };
    if (this.asked) this.followQuestion();
    this.onChange();
  }

  // The server ended the connection or did not let it drive; `why` as `lost` in states.js.
  lose(why, reason) {
    this.mode = "observe";
    this.armed = false;
    this.note = { why, reason };
    this.onChange();
  }

  // A person took the wheel: `why` tells how.
  drive(why = "drive") {
    this.sit({ armed: why !== "released" });
  }

  // This page is told nothing any more.
  end() {
    Object.assign(this, { control: NOTHING, asked: null, note: null });
    this.onChange();
  }

  leave() {
    this.mode = "observe";
    this.armed = false;
    this.note = { why: "left" };
    this.onMove();
    this.onChange();
  }

  arm() {
    this.armed = true;
    this.note = null;
    this.onChange();
  }

  ask() {
    this.asked = "sent";
    this.note = null;
    this.onChange();
  }

  // The question is over from this side: withdrawn, or not taken by the server.
  forget(note = null) {
    this.asked = null;
    this.note = note;
    this.onChange();
  }

  say(note) {
    this.note = note;
    this.onChange();
  }

  followQuestion() {
    const { driver, waiting, reserved, stopped } = this.control;
    if (waiting?.user === this.me) this.asked = "waiting";
    else if (stopped) this.endQuestion({ why: "stopped_meanwhile" });
    else if (reserved?.user === this.me) this.sit({ armed: false, why: "arrived" });
    else if (this.asked === "waiting") this.unanswered(driver, reserved);
  }

  // What was asked no longer stands, and control did not come.
  unanswered(driver, reserved) {
    if (!driver && !reserved) this.sit({ armed: false, why: "arrived" });
    else if (driver && driver.user !== this.me) this.endQuestion({ why: "refused", by: driver.user });
    else this.endQuestion(null);
  }

  endQuestion(note) {
    this.asked = null;
    this.note = note;
  }

  sit({ armed, why = null }) {
    this.mode = "drive";
    this.armed = armed;
    this.endQuestion(why && { why });
    this.onMove();
    this.onChange();
  }

  // Who asks the person at this page for the control, or null.
  get asking() {
    const { driver, waiting } = this.control;
    return this.driving && driver?.user === this.me ? waiting : null;
  }

  // The names of what can be done now; `live` says whether the connection stands.
  deeds(live) {
    if (!this.mayDrive || !live) return [];
    if (this.driving) return this.armed ? ["leave"] : ["arm", "leave"];
    if (this.control.stopped) return [];
    if (this.asked) return ["withdraw", ...this.taking()];
    return [...this.turns(), ...this.taking()];
  }

  turns() {
    const { driver, waiting, reserved } = this.control;
    const other = driver ?? reserved;
    if (!other || other.user === this.me) return ["drive"];
    return driver && !waiting ? ["ask"] : [];
  }

  taking() {
    const { driver } = this.control;
    return this.level === "manage" && driver && driver.user !== this.me ? ["take"] : [];
  }
}
