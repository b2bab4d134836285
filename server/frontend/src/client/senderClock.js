// Tells when a picture was taken, by this page's clock (docs/media.md, "SenderClock"). A beat is on its way for a while
// before the sender reads its clock, so each difference is at least the true one, and the least comes nearest: a
// moment is never told later than it was. Pure.

const MAX_AGE_MS = 30_000;
const STEP_MS = 250; // over what clocks drift in that time, and over what browsers blur them by

export class SenderClock {
  // `now()` may stand still while the machine sleeps, as performance.now() does; `wall()` goes on.
  constructor({ now, wall }) {
    Object.assign(this, { now, wall });
    this.samples = [];
  }

  // The answer to a beat that was asked at `t_ms` of `now()`.
  receive({ t_ms, sender_ms }) {
    if (!Number.isFinite(t_ms) || !Number.isFinite(sender_ms)) return;
    const at = this.now();
    this.samples = [...this.fresh(at), { at, ahead: sender_ms - t_ms, slept: this.wall() - at }];
  }

  // The moment on the clock of `now()`; null while nothing is known of the sender's clock.
  timestamp(sender_ms) {
    const now = this.now();
    const known = this.fresh(now).map(({ ahead }) => ahead);
    return known.length ? Math.min(now, sender_ms - Math.min(...known)) : null;
  }

  // After a sleep of this machine, what was known would make old pictures look new.
  fresh(at) {
    const slept = this.wall() - at;
    return this.samples.filter(
      (sample) => at - sample.at <= MAX_AGE_MS && Math.abs(slept - sample.slept) < STEP_MS,
    );
  }
}
