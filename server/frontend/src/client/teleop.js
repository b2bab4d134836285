// Turns what the operator holds into drive commands: 20 Hz while anything is held, zero on release,
// then silence, so that the page never fights another controller. Pure except for its timer.
// It must never send anything but zero unless it is armed and an input is held that was pressed since then, or whose
// press took the control.

/**
 * @typedef {{forward: number, left: number, turn: number}} Twist in m/s, m/s and rad/s
 * @typedef {{publish: (twist: Twist, timestamp: number) => void, readonly mayQueue: boolean}} Output where commands go: the session,
 *   or what stands before it. The timestamp is by the clock of event.timeStamp; `mayQueue` is false while old commands wait to be sent.
 */

/** @type {Twist} */
export const STILL = { forward: 0, left: 0, turn: 0 };

const PERIOD_MS = 50;
const ZEROS = 5; // number of zeros after a release: one could be lost in a cut, five cover a quarter of a second
const GAP_MS = 500; // time without a command after which the robot has stopped by itself
const LATE_MS = 300; // greatest delay of a timer: on a page that is later, a release may have been missed
const TAKE_MS = 1000; // time limit for a press to bring the control

/** @type {{onDrop: () => void, onTake: () => void, onWanted: (twist: Twist) => void}} */
const NO_HANDLERS = { onDrop() {}, onTake() {}, onWanted() {} };

export class Teleop {
  // A command has the timestamp at which it was pressed, or last seen that it is still held. Handlers: `onDrop()` reports to the
  // inputs that what they hold no longer counts; `onTake()` comes with a press while it watches; `onWanted(twist)` shows.
  // `now()` must go on while the machine sleeps, which performance.now() does not everywhere; `timestamp()` is the clock of
  // event.timeStamp. `limits` and `kind` as of `mixed`.
  /**
   * @param {{
   *   output: Output,
   *   limits: Limits | null,
   *   kind?: string,
   *   now?: () => number,
   *   timestamp?: () => number,
   * } & Partial<typeof NO_HANDLERS>} options
   */
  constructor({ output, limits, kind = "differential", now = () => Date.now(), timestamp = () => performance.now(), ...handlers }) {
    this.output = output;
    this.limits = limits;
    this.kind = kind;
    this.now = now;
    this.timestamp = timestamp;
    this.handlers = { ...NO_HANDLERS, ...handlers };
    this.armed = false;
    this.watching = false;
    this.held = new Map();
    this.zerosLeft = 0;
    this.sentAt = this.tickedAt = this.seenAt = NaN; // before the first command
  }

  // Without a live connection nothing is accepted. What is held when one ends or begins must be let go
  // and pressed anew, except the press that took the control: still held, it drives from here.
  arm(armed) {
    const taken = armed && this.takes;
    if (!taken) this.drop();
    this.armed = armed;
    this.watching = false;
    if (!taken) return;
    this.sentAt = this.now();
    this.tick();
  }

  // Whether a press while it watched is held still, and came lately.
  get takes() {
    return this.watching && this.held.size > 0 && !this.stale;
  }

  // On a page that watches: a press sends nothing, but says by onTake() that a person wants to drive.
  watch() {
    if (this.watching) return;
    this.arm(false);
    this.watching = true;
  }

  get accepts() {
    return this.armed || this.watching;
  }

  // On a link that stands, where a person may not drive on: what is under way ends with zeros, and nothing counts
  // until it is armed again and pressed anew.
  disarm() {
    this.letGo();
    this.armed = this.watching = false;
  }

  // `input` names keyboard, joystick or the like; `value` as of `mixed`; `at` is the event's timestamp. One that is
  // polled says for how many ms its value holds: nothing reports when polling ends.
  hold(input, value, at = this.timestamp(), goodForMs = Infinity) {
    if (!this.accepts) return;
    const starting = this.held.size === 0;
    this.held.set(input, { value, at, goodForMs });
    if (starting) this.start(at);
  }

  release(input) {
    if (this.held.delete(input) && this.held.size === 0 && this.armed) this.zero();
  }

  // Ends any motion input at once. Zeroes also when nothing is held here, and before anything else.
  halt() {
    this.held.clear();
    if (this.armed) this.zero();
    this.handlers.onDrop();
  }

  // For a page that nobody may be looking at. Silent when nothing is held, since somebody else may drive.
  letGo() {
    if (this.held.size > 0) this.halt();
    else this.handlers.onDrop();
  }

  get wanted() {
    const values = [...this.held.values()].map(({ value }) => value);
    return mixed(values, /** @type {Limits} */ (this.limits), this.kind);
  }

  start(at) {
    this.zerosLeft = 0;
    this.restartTimer();
    if (this.armed) this.sendWanted(Math.min(at, this.timestamp()));
    else this.handlers.onTake();
  }

  zero() {
    this.zerosLeft = ZEROS;
    this.restartTimer();
    this.sendZero();
  }

  drop() {
    clearInterval(this.timer);
    this.held.clear();
    this.zerosLeft = 0;
    this.handlers.onDrop();
    this.handlers.onWanted(STILL);
  }

  restartTimer() {
    this.sentAt = this.tickedAt = this.now();
    this.seenAt = this.timestamp();
    clearInterval(this.timer);
    this.timer = setInterval(() => this.tick(), PERIOD_MS);
  }

  tick() {
    const { stale } = this;
    const seenAt = this.see();
    if (this.held.size === 0 && this.zerosLeft === 0) clearInterval(this.timer);
    else if (stale) this.dropStale();
    else if (this.held.size === 0) this.sendZero();
    else if (this.armed) this.sendWanted(seenAt);
  }

  // The timestamp for which this tick can answer. A late one may run before the release that came meanwhile, so
  // it answers for no more than the time at which it should have run.
  see() {
    const due = this.seenAt + PERIOD_MS;
    this.tickedAt = this.now();
    this.seenAt = this.timestamp();
    return Math.min(due, this.seenAt, ...this.polls.map(({ at }) => at));
  }

  get stale() {
    return this.late || this.stuck || this.unpolled;
  }

  get polls() {
    return [...this.held.values()].filter(({ goodForMs }) => goodForMs < Infinity);
  }

  // True when a polled input has not been polled for too long.
  get unpolled() {
    return this.polls.some(({ at, goodForMs }) => this.timestamp() - at > goodForMs);
  }

  // True when this page was frozen or throttled, or this machine asleep.
  get late() {
    return Math.abs(this.now() - this.tickedAt) > PERIOD_MS + LATE_MS;
  }

  // True when the network took nothing for as long as the robot waits, or a press did not bring the control in time.
  get stuck() {
    return Math.abs(this.now() - this.sentAt) > (this.armed ? GAP_MS : TAKE_MS);
  }

  // The release may have been missed meanwhile, and a robot that stopped must not start by itself.
  dropStale() {
    if (this.held.size > 0) this.halt();
    else this.drop();
  }

  // It goes out first: what is shown takes its time, and may fail.
  sendWanted(at) {
    const wanted = this.wanted;
    if (this.output.mayQueue) this.pass(wanted, at);
    this.handlers.onWanted(wanted);
  }

  // Zero is meant whenever it is sent.
  sendZero() {
    this.zerosLeft -= 1;
    this.pass(STILL, this.timestamp());
    this.handlers.onWanted(STILL);
  }

  pass(twist, at) {
    this.sentAt = this.now();
    this.output.publish(twist, at);
  }
}

// Mixes all inputs to a twist that this kind of robot can follow, within the limits. Pure.
// `inputs` are {forward, left, turn} from -1 to 1, forward and left positive, `turbo` true for the higher limits.
// `limits` are {linear, angular} in m/s and rad/s, with `turbo` of the same shape, and `most`: the robot's own.
/**
 * @typedef {{linear: number, angular: number}} Speeds
 * @typedef {Speeds & {turbo?: Speeds, most?: Speeds}} Limits
 */

/** @type {(inputs: (Partial<Twist> & {turbo?: boolean})[], limits: Limits, kind: string) => Twist} */
export function mixed(inputs, limits, kind) {
  const { linear, angular } = inputs.some(({ turbo }) => turbo) ? (limits.turbo ?? limits) : limits;
  const [forward, left, turn] = ["forward", "left", "turn"].map((name) => total(inputs, name));
  if (kind === "holonomic") return { ...together(forward, left, linear), turn: turn * angular };
  if (kind === "ackermann") return steered(forward * linear, turn * angular, limits.most?.linear ?? linear);
  return { forward: forward * linear, left: 0, turn: turn * angular };
}

const total = (inputs, name) => clamp(inputs.reduce((sum, input) => sum + (input[name] ?? 0), 0));

const clamp = (value) => Math.min(1, Math.max(-1, value)) + 0; // + 0 turns -0 into 0

// The limit is that of the speed, whichever way it goes.
function together(forward, left, linear) {
  const scale = linear / Math.max(1, Math.hypot(forward, left));
  return { forward: forward * scale, left: left * scale };
}

// A car turns as it goes, the other way when it backs: the stick says how far the wheels are turned, and
// `turn` is what that makes at the robot's highest speed.
const steered = (forward, turn, highest) => ({ forward, left: 0, turn: (turn * forward) / highest + 0 });
