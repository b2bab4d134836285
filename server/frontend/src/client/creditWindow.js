// How many frames of one link may be on their way: two, one of which is shown while the next comes, and as many more as
// come in the shortest round trip. With fewer its length would bound their rate; with more, what is shown would be late where
// the line is full. Pure; times are in ms of one clock.

const CREDITS = 2;
const MAX_CREDITS = 8; // the server takes no more
const MAX_INTERVAL_MS = 1000;
const WEIGHT = 0.1; // of the last interval between frames
const NEARLY = 0.75; // part of an encoded frame on the way that counts as one; a JPEG must be there whole: JPEGs fill lines

export class CreditWindow {
  constructor() {
    this.open = 0; // granted, and not done with
    this.roundTripMs = Infinity;
    this.intervalMs = MAX_INTERVAL_MS;
    this.cameAt = 0;
    this.part = 1;
  }

  // Never that of the last answers alone: where frames fill the line, all of those have waited behind them.
  answered(roundTripMs) {
    if (roundTripMs >= 0) this.roundTripMs = Math.min(this.roundTripMs, roundTripMs);
  }

  came(at, codec) {
    this.part = codec === "jpeg" ? 1 : NEARLY;
    const passedMs = Math.min(MAX_INTERVAL_MS, at - this.cameAt);
    this.intervalMs += WEIGHT * (passedMs - this.intervalMs);
    this.cameAt = at;
  }

  // Gives how many more frames to ask for when it is done with so many.
  grant(done) {
    this.open -= done;
    const ofWay = this.roundTripMs === Infinity ? 0 : Math.floor(this.roundTripMs / this.intervalMs + 1 - this.part);
    const frames = Math.max(0, Math.min(MAX_CREDITS, CREDITS + ofWay) - this.open);
    this.open += frames;
    return frames;
  }
}
