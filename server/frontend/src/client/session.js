// All that drives a robot over one connection that stays: the connection itself, the relay's clock, the state of control,
// and drive commands, each with its timestamp. Used by the drive page and by index.js.
// It must never believe what a robot says in the relay's name.

import { Connection } from "./connection.js";
import { driveMessage, finite, openLink } from "./rosbridge.js";
import { RttProbe, median } from "./rtt.js";

/**
 * @typedef {import("./teleop.js").Twist} Twist
 * @typedef {{camera: string, frame: number | null}} NamedFrame a frame that is seen, by its sequence number; null: unknown
 * @typedef {{ageMs: number | null, maxSpeed: number | null, maxTurn: number | null}} Seen how old was what was seen, null for unknown, and
 *   the limits in m/s and rad/s to which the robot slowed the newest command for that, null for none
 * @typedef {{t_ms?: number, seen?: NamedFrame[]}} Stamp the timestamp of a command in the relay's time, and what was seen
 */

/**
 * Who drives, and whether the robot is stopped (docs/reference/protocols.md, "Control").
 * @typedef {{
 *   driver: {user: string, since: string, fence: number} | null,
 *   waiting: {user: string, passes_at: string} | null,
 *   reserved: {user: string, until: string} | null,
 *   stopped: {by: string, at: string, confirmed: boolean} | null,
 *   guard: string,
 *   blind_limits?: boolean | null,
 * }} Control
 */

const MAX_BACKLOG_BYTES = 2048; // about half a second of drive commands
const MAX_SILENCE_MS = 2000; // of the robot, which answers each second: what is sent into silence arrives late

export class Session {
  // `driveTopic` is driven, "" for none; `wheelbase` in m of a robot that steers. `requestUrl()`, `prepare`, `onState` and `onLeaving` as
  // of connection.js; `seenAt(timestamp)` gives the frames that the driver saw then, undefined for a client that names none, and
  // `onSeen(seen)` reports how old they were at the robot; `onControl(control)` with what is known of who drives and whether the robot
  // is stopped; `onRoundTrip` as of rtt.js.
  /**
   * @param {{
   *   driveTopic: string,
   *   wheelbase: number | null,
   *   requestUrl: () => Promise<string>,
   *   prepare: (call: import("./rosbridge.js").Link["call"]) => Promise<void>,
   *   onState: (state: import("./connection.js").State) => void,
   *   onLeaving: () => void,
   *   onControl: (control: Control) => void,
   *   onRoundTrip: (reading: {medianMs: number, ageMs: number} | null) => void,
   *   seenAt?: (timestamp: number) => NamedFrame[] | undefined,
   *   onSeen?: (seen: Seen) => void,
   * }} options
   */
  constructor({
    driveTopic,
    wheelbase,
    requestUrl,
    prepare,
    onState,
    onLeaving,
    onControl,
    onRoundTrip,
    seenAt = () => undefined,
    onSeen = () => {},
  }) {
    this.seenAt = seenAt;
    this.onSeen = onSeen;
    this.clockSync = new ClockSync();
    this.controlState = new ControlState({ onControl });
    this.connection = new Connection({
      requestTicket: requestUrl,
      openLink,
      prepare,
      onState: (state) => {
        this.probe(state);
        onState(state);
      },
      onLeaving,
      onLink: (send) => (send ? this.clockSync.start(send) : this.forgetLink()),
      onOwn: (operation) => this.receive(operation),
    });
    // Also what keeps a quiet link from looking like a dead one: the robot answers each second.
    this.rtt = new RttProbe({ call: (service, request) => this.connection.call(service, request), onReading: onRoundTrip });
    this.driveTopic = driveTopic;
    this.wheelbase = wheelbase;
    this.type = "";
    /** @type {ReturnType<Connection["advertise"]> | null} */
    this.publisher = null;
    this.driving = false;
  }

  // The type of drive messages that the robot takes, as soon as it is known.
  useType(type) {
    if (type === this.type) return;
    this.type = type;
    this.renewPublisher();
  }

  // Whether the connection drives: on one that only watches, the server would refuse to let it advertise.
  use(driving) {
    this.driving = driving;
    this.renewPublisher();
  }

  renewPublisher() {
    this.publisher?.end();
    const { driving, type, driveTopic: name } = this;
    this.publisher = driving && type && name ? this.connection.advertise({ name, type }) : null;
  }

  /** @type {(twist: Twist, timestamp: number) => void} */
  publish(twist, timestamp) {
    const { type, wheelbase } = this;
    this.publisher?.publish(driveMessage(type, twist, { wheelbase }), this.stamp(timestamp));
  }

  // What {robotether} of a drive message says; undefined for nothing.
  /** @type {(timestamp: number) => Stamp | undefined} */
  stamp(timestamp) {
    const [stamp, seen] = [this.clockSync.stamp(timestamp), this.seenAt(timestamp)];
    return seen ? { ...stamp, seen } : stamp;
  }

  probe({ name }) {
    if (name === "live") this.rtt.start();
    else this.rtt.stop();
  }

  // Ends it for good.
  stop() {
    this.rtt.stop();
    this.connection.stop();
  }

  receive(operation) {
    if (!this.clockSync.isRelays(operation)) return;
    if (operation.op === "robotether.clock_sync") this.clockSync.receive(operation);
    if (operation.op === "robotether.seen") this.onSeen(seenOf(operation));
    if (operation.op === "robotether.control") this.controlState.fromLink(operation.control);
  }

  forgetLink() {
    this.clockSync.stop();
    this.controlState.linkEnded();
  }

  // Whether a command that is sent now would be at the robot soon, and not wait behind old ones.
  get mayQueue() {
    const { backlog, silenceMs } = this.connection;
    return backlog < MAX_BACKLOG_BYTES && silenceMs < MAX_SILENCE_MS;
  }

  // Stops the robot. Says whether it went; the caller asks the API as well, with the same `press`: the server takes what
  // comes later for the same stop, also when that has been released.
  stopRobot(press) {
    return this.connection.send({ op: "robotether.stop", press });
  }
}

/** @type {(operation: any) => Seen} */
const seenOf = ({ age_ms, max_speed_m_s, max_turn_rad_s }) => ({
  ageMs: finite(age_ms),
  maxSpeed: finite(max_speed_m_s),
  maxTurn: finite(max_turn_rad_s),
});

// What is known of a robot's control object (docs/reference/protocols.md, "Control"). It comes twice: on the page's own
// connection and with the fleet's events. Mixing them would bring old states after new ones, so while the
// connection reports it, it alone counts. Pure except for its clock.
const LATE_MS = 5000; // time by which the events may bring later what the connection has reported

export class ControlState {
  /** @param {{onControl: (control: Control) => void, now?: () => number}} options */
  constructor({ onControl, now = () => performance.now() }) {
    this.onControl = onControl;
    this.now = now;
    this.linked = false;
    this.pending = null;
    this.ahead = /** @type {{text: string, at: number}[]} */ ([]); // what the connection reported and the events may still bring, late
    this.fed = "";
  }

  fromLink(control) {
    const text = JSON.stringify(control);
    this.ahead = text === this.fed ? [] : [...this.recent, { text, at: this.now() }];
    this.linked = true;
    this.pending = null;
    this.onControl(control);
  }

  // What the connection has reported is no news, not even when the connection has ended.
  fromFeed(control) {
    this.fed = JSON.stringify(control);
    const { recent } = this;
    const place = recent.findIndex(({ text }) => text === this.fed);
    this.ahead = place < 0 ? [] : recent.slice(place + 1);
    if (place >= 0) this.pending = null;
    else if (this.linked) this.pending = control;
    else this.onControl(control);
  }

  get recent() {
    return this.ahead.filter(({ at }) => this.now() - at < LATE_MS);
  }

  // What the events alone reported since the connection's last report counts when the connection has ended.
  linkEnded() {
    const { pending } = this;
    this.linked = false;
    this.pending = null;
    if (pending) this.onControl(pending);
  }
}

// This page's clock against the relay's, by clock syncs over the rosbridge connection (docs/reference/protocols.md, "Age").
// An answer is on its way for a while, so each difference is at most the true one, and the greatest comes
// nearest: a timestamp in the relay's time is never later than the truth. Pure except for its timer.
const SYNC_MS = 250;
const MAX_AGE_MS = 10_000;
const SAMPLES = 12; // number of round trips of which the median is taken: those of three seconds

const KEY_BYTES = 16;

export class ClockSync {
  // `now()` is the clock of event.timeStamp.
  constructor({ now = () => performance.now() } = {}) {
    this.now = now;
    this.samples = /** @type {{at: number, ahead: number}[]} */ ([]);
    this.roundTrips = /** @type {number[]} */ ([]);
    this.heardAt = now();
    this.forget();
  }

  // `send(message)` sends on the connection that has just opened. What another one reported is forgotten: it may
  // have been another relay, which has another clock.
  start(send) {
    this.stop();
    this.send = send;
    this.key = randomKey();
    this.timer = setInterval(() => this.sendSync(), SYNC_MS);
    this.sendSync();
  }

  stop() {
    clearInterval(this.timer);
    this.forget();
  }

  forget() {
    this.key = undefined;
    this.samples = [];
    this.roundTrips = [];
    this.heardAt = this.now();
  }

  // How long the relay has said nothing, which answers each clock sync; of no use while there is no link.
  get silenceMs() {
    return this.now() - this.heardAt;
  }

  sendSync() {
    this.send({ op: "robotether.clock_sync", t_ms: this.now(), key: this.key });
  }

  // Whether the relay said it. A robot can say the same, as the relay passes its messages on unread; but no robot
  // sees the key, which goes to the relay in the clock syncs and comes back with all that it says itself.
  isRelays({ key }) {
    return this.key !== undefined && key === this.key;
  }

  receive({ t_ms, relay_ms }) {
    if (!Number.isFinite(relay_ms)) return;
    const at = this.now();
    this.heardAt = at;
    if (Number.isFinite(t_ms)) this.roundTrips = [...this.roundTrips, at - t_ms].slice(-SAMPLES);
    this.samples = [...this.fresh(at), { at, ahead: relay_ms - at }];
  }

  // The timestamp `t_ms` in the relay's time; undefined while nothing is known,
  // and then the relay goes by its own pings.
  /** @type {(t_ms: number) => {t_ms: number} | undefined} */
  stamp(t_ms) {
    const offsets = this.fresh(this.now()).map(({ ahead }) => ahead);
    return offsets.length ? { t_ms: t_ms + Math.max(...offsets) } : undefined;
  }

  // Between this page and the relay and back; null while it is not known.
  get roundTripMs() {
    return this.roundTrips.length ? median(this.roundTrips) : null;
  }

  fresh(at) {
    return this.samples.filter((sample) => at - sample.at <= MAX_AGE_MS);
  }
}

export function randomKey() {
  const bytes = crypto.getRandomValues(new Uint8Array(KEY_BYTES));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
