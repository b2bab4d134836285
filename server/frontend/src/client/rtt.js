// Measures the round trip browser - robot's rosbridge - browser with one small service call a second.
// An answer that says that the service failed has made the same trip, so it counts as well.

const PERIOD_MS = 1000;
const LOST_MS = 5000;
const SAMPLES = 5;

export class RttProbe {
  // `call(service, request)` as of connection.js; `onReading` gets {medianMs, ageMs} or null for unknown.
  constructor({ call, onReading, now = () => performance.now() }) {
    this.call = call;
    this.onReading = onReading;
    this.now = now;
    this.samples = /** @type {number[]} */ ([]);
    this.lastAt = this.askedAt = /** @type {number | null} */ (null);
  }

  start() {
    this.stop();
    this.timer = setInterval(() => this.tick(), PERIOD_MS);
    this.tick();
  }

  stop() {
    clearInterval(this.timer);
    this.forget();
  }

  forget() {
    this.samples = [];
    this.lastAt = null;
    this.askedAt = null;
    this.onReading(null);
  }

  tick() {
    const waiting = this.askedAt !== null && this.now() - this.askedAt < LOST_MS;
    if (!waiting) this.ask();
    this.report();
  }

  async ask() {
    const askedAt = (this.askedAt = this.now());
    try {
      await this.call("/rosapi/get_time", {});
    } catch {
      return; // not connected: the connection's own state says so
    }
    if (askedAt !== this.askedAt) return;
    this.askedAt = null;
    this.lastAt = this.now();
    this.samples = [...this.samples, this.lastAt - askedAt].slice(-SAMPLES);
    this.report();
  }

  report() {
    if (this.lastAt === null) return;
    this.onReading({ medianMs: median(this.samples), ageMs: this.now() - this.lastAt });
  }
}

export function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
}
