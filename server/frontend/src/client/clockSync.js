// This page's clock against the relay's, by beats over the rosbridge connection (docs/reference/protocols.md, "Age of commands").
// An answer is on its way for a while, so each difference is at most the true one, and the greatest comes
// nearest: a moment that is told in the relay's time is never told later than it was. Pure but for its timer.

import { median } from "./rtt.js";

const PERIOD_MS = 250;
const MAX_AGE_MS = 10_000;
const SAMPLES = 12; // three seconds of them

const KEY_BYTES = 16;

export class ClockSync {
  // `now()` is the clock of event.timeStamp.
  constructor({ now = () => performance.now() } = {}) {
    this.now = now;
    this.forget();
  }

  // `send(message)` sends on the connection that has just opened. What another one told is forgotten: it may
  // have been another relay, which has another clock.
  start(send) {
    this.stop();
    this.send = send;
    this.key = randomKey();
    this.timer = setInterval(() => this.sendSync(), PERIOD_MS);
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
  }

  sendSync() {
    this.send({ op: "robotether.beat", t_ms: this.now(), key: this.key });
  }

  // Whether the relay said it. A robot can say the same, as the relay passes its messages on unread; but no robot
  // sees the key, which goes to the relay in the beats and comes back with all that it says itself.
  isRelays({ key }) {
    return this.key !== undefined && key === this.key;
  }

  receive({ t_ms, relay_ms }) {
    if (!Number.isFinite(relay_ms)) return;
    const at = this.now();
    if (Number.isFinite(t_ms)) this.roundTrips = [...this.roundTrips, at - t_ms].slice(-SAMPLES);
    this.samples = [...this.fresh(at), { at, ahead: relay_ms - at }];
  }

  // What {robotether} of a drive message is to say of the moment `t_ms`; undefined while nothing is known,
  // and then the relay goes by its own pings.
  stamp(t_ms) {
    const known = this.fresh(this.now()).map(({ ahead }) => ahead);
    return known.length ? { t_ms: t_ms + Math.max(...known) } : undefined;
  }

  // Between this page and the relay and back; null while it is not known.
  get roundTripMs() {
    return this.roundTrips.length ? median(this.roundTrips) : null;
  }

  fresh(at) {
    return this.samples.filter((sample) => at - sample.at <= MAX_AGE_MS);
  }
}

function randomKey() {
  const bytes = crypto.getRandomValues(new Uint8Array(KEY_BYTES));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
