// Pictures a second, over the last two seconds. Pure.

const SPAN_MS = 2000;

export class Rate {
  constructor() {
    this.timestamps = [];
  }

  hit(now) {
    this.timestamps = [...this.fresh(now), now];
  }

  // One decimal; null before there are two to tell a rate from.
  perSecond(now) {
    const timestamps = this.fresh(now);
    if (timestamps.length < 2) return timestamps.length ? null : 0;
    const span = Math.max(now, timestamps.at(-1)) - timestamps[0];
    return Math.round(((timestamps.length - 1) * 10_000) / span) / 10;
  }

  fresh(now) {
    return this.timestamps.filter((timestamp) => now - timestamp <= SPAN_MS);
  }
}
