// Pictures a second, over the last two seconds. Pure.

const SPAN_MS = 2000;

export class Rate {
  constructor() {
    this.moments = [];
  }

  hit(now) {
    this.moments = [...this.fresh(now), now];
  }

  // One decimal; null before there are two to tell a rate from.
  perSecond(now) {
    const moments = this.fresh(now);
    if (moments.length < 2) return moments.length ? null : 0;
    const span = Math.max(now, moments.at(-1)) - moments[0];
    return Math.round(((moments.length - 1) * 10_000) / span) / 10;
  }

  fresh(now) {
    return this.moments.filter((moment) => now - moment <= SPAN_MS);
  }
}
