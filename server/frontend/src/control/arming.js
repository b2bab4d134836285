// Decides whether input counts: by the drive mode, and by the video interlock, which knows whether the person can see. Pure.
// It must never let anything but zero through while driving is held, nor let what was held through it drive on.

// Of who only watches.
/** @type {any} */
export const NO_CONTROLS = { arm() {}, watch() {}, disarm() {}, letGo() {}, halt() {}, useType: () => "", held: () => false };

export class Arming {
  // `output` as of teleop.js; it is one itself, for the controls' teleop. `interlock` is a VideoInterlock.
  /** @param {{interlock: VideoInterlock, output: import("../client/teleop.js").Output}} options */
  constructor({ interlock, output }) {
    this.interlock = interlock;
    this.output = output;
    this.controls = NO_CONTROLS;
    this.armed = false;
  }

  // Those of controls.js, whose commands come here.
  use(controls) {
    this.controls = controls;
  }

  // `mayMove`: the link stands, this page drives, and the person has begun. `watches`: a press is reported all the same, and
  // takes the control if `free`.
  update({ mayMove, watches = false, free = false }) {
    if (mayMove && this.interlock.held) this.hold();
    else if (mayMove) this.arm();
    else if (watches) this.watch(free);
    else this.disarm();
  }

  arm() {
    if (this.armed) return;
    this.armed = true;
    this.controls.arm(true);
  }

  watch(free) {
    this.armed = false;
    this.controls.watch(free);
  }

  // A link that is given up may yet deliver a last command.
  leave() {
    if (this.armed) this.controls.letGo();
  }

  // Nothing is said: there may be no link, or somebody else may drive.
  disarm() {
    this.armed = false;
    this.controls.arm(false);
  }

  // The link stands, so a zero is sent to the robot.
  hold() {
    this.controls.disarm();
    this.armed = false;
  }

  // Each command asks anew whether the person can see: a timer may be late.
  /** @type {(twist: import("../client/teleop.js").Twist, timestamp: number) => void} */
  publish(twist, timestamp) {
    this.interlock.check();
    const still = !twist.forward && !twist.left && !twist.turn;
    if (still || !this.interlock.held) this.output.publish(twist, timestamp);
  }

  get mayQueue() {
    return this.output.mayQueue;
  }
}

// Decides whether driving pauses because the person cannot see what the robot sees now.
// It must never take a frame for newer than its timestamp, nor its own timer for what keeps it honest: what asks
// whether a command may go asks check() right then.
export class VideoInterlock {
  // `afterMs`: the greatest age of the frame, null for any. `onChange()` comes when `kind` has become another.
  // `now()` is the clock of ages, which may stand still in a sleep of the machine; `wall()` goes on.
  /** @param {{afterMs: number | null, onChange?: () => void, now?: () => number, wall?: () => number}} options */
  constructor({ afterMs, onChange = () => {}, now = () => performance.now(), wall = () => Date.now() }) {
    this.afterMs = afterMs;
    this.onChange = onChange;
    this.now = now;
    this.wall = wall;
    this.offered = true; // before the first word: no frame yet
    /** @type {number | null} */
    this.at = null;
    this.allowed = false;
    this.sleep = new Sleep();
    this.wokeAt = -Infinity;
    this.noteSleep();
    this.kind = this.found;
  }

  // `offered`: there may be a camera, and the page is seen. `at`: the timestamp of the main frame on the clock of `now()`, or null.
  /** @param {{offered: boolean, at: number | null}} reading */
  receive({ offered, at }) {
    this.offered = offered;
    this.at = at !== null && Number.isFinite(at) ? Math.min(at, this.now()) : null;
    this.check();
  }

  // A person wants to drive without seeing, until the video is back.
  allow() {
    this.allowed = true;
    this.check();
  }

  // What a person allowed was for the link on which they said it.
  revoke() {
    this.allowed = false;
    this.check();
  }

  check() {
    this.noteSleep();
    const { found } = this;
    if (found === "seen") this.allowed = false;
    if (found === this.kind) return;
    this.kind = found;
    this.onChange();
  }

  // What was seen before a sleep is as old as that, whatever its clock says.
  noteSleep() {
    const now = this.now();
    if (this.sleep.isOver(now, this.wall())) this.wokeAt = now;
  }

  get ageMs() {
    return this.at === null ? null : this.now() - this.at;
  }

  // "seen": drive; "off": there is nothing to see; "missing", "old": held; "blind": allowed all the same.
  // `kind` is what was found at the last check, so that all who read it between two read the same, and learn of each change.
  get found() {
    if (this.afterMs === null || !this.offered) return "off";
    const why = this.lack;
    return why && this.allowed ? "blind" : why || "seen";
  }

  get lack() {
    if (this.at === null) return "missing";
    return this.now() - this.at > (this.afterMs ?? Infinity) || this.at < this.wokeAt ? "old" : "";
  }

  get held() {
    return this.kind === "missing" || this.kind === "old";
  }
}

// performance.now() may stand still while the machine sleeps, and what was seen before would look new after it.
const STEP_MS = 250; // least step between two clocks of this machine that counts as a sleep

export class Sleep {
  constructor() {
    this.apart = NaN;
  }

  // Says whether the machine slept since the last look; `wall` is the time of day, which goes on.
  isOver(now, wall) {
    const before = this.apart;
    this.apart = wall - now;
    return Math.abs(this.apart - before) > STEP_MS;
  }
}
