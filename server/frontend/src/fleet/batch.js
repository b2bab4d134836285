// Gathers changes until the next frame, and calls for what is costly seldom. Pure but for its timers.

export class Batch {
  // `apply(names)` gets what changed since the last time, once a frame.
  constructor({ apply, frame = (act) => requestAnimationFrame(act) }) {
    Object.assign(this, { apply, frame });
    this.names = new Set();
  }

  add(name) {
    if (this.names.size === 0) this.frame(() => this.flush());
    this.names.add(name);
  }

  flush() {
    const { names } = this;
    this.names = new Set();
    if (names.size > 0) this.apply(names);
  }
}

export class Seldom {
  // Calls `act` at most once in so many ms: at once if it is long ago, else at the end of the time.
  constructor({ act, everyMs, now = () => performance.now() }) {
    Object.assign(this, { act, everyMs, now });
    this.actedAt = -Infinity;
    this.timer = null;
  }

  ask() {
    if (this.timer !== null) return;
    const wait = this.actedAt + this.everyMs - this.now();
    if (wait <= 0) this.run();
    else this.timer = setTimeout(() => this.run(), wait);
  }

  run() {
    clearTimeout(this.timer);
    this.timer = null;
    this.actedAt = this.now();
    this.act();
  }
}
