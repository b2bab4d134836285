// The frames that one place of a page has shown lately, and which of them a person saw at a given time.
const KEPT_MS = 2000; // a command is never of an input that is longer ago
const MAX_NAMED = 8; // maximum number of frames that a command names

/** @typedef {{sequence: number, at: number, shownAt: number}} ShownFrame `at` is its timestamp; both times are on the page's clock */

// What is drawn now is in the display's next picture, which is on the screen when the one after it begins.
/** @type {(act: () => void) => void} */
const afterDisplay = (act) => void requestAnimationFrame(() => requestAnimationFrame(act));

export class ShownFrames {
  constructor({ now = () => performance.now() } = {}) {
    this.now = now;
    this.round = 0;
    this.frames = /** @type {ShownFrame[]} */ ([]);
  }

  // A frame was drawn: until it is on the screen the one before is seen.
  /** @type {(frame: {sequence: number, at: number}) => void} */
  draw({ sequence, at }) {
    const { round } = this;
    if (globalThis.document?.hidden) return; // nobody sees it, and the browser would keep each callback until somebody does
    afterDisplay(() => round === this.round && this.note({ sequence, at, shownAt: this.now() }));
  }

  // The one before those of the last seconds is kept, too: it was seen until the first of them came.
  /** @type {(frame: ShownFrame) => void} */
  note(frame) {
    const from = frame.shownAt - KEPT_MS;
    const { frames } = this;
    this.frames = [...frames.filter((_, place) => (frames[place + 1] ?? frame).shownAt > from), frame];
  }

  // What was shown may be older than it says.
  forget() {
    this.round += 1;
    this.frames = [];
  }

  // The frame that was to be seen at this time; null before the first.
  /** @type {(timestamp: number) => ShownFrame | null} */
  seenAt(timestamp) {
    return this.frames.filter(({ shownAt }) => shownAt <= timestamp).at(-1) ?? null;
  }
}

// Of the frames that were seen at this time the oldest, as the robot goes by the oldest: one that is unknown or of unknown age
// may be older than all.
/** @type {(views: {topic: string, frames: ShownFrames}[], timestamp: number) => {camera: string, frame: number | null}[]} */
export function oldestSeen(views, timestamp) {
  const seen = views.map(({ topic, frames }) => ({ topic, frame: frames.seenAt(timestamp) }));
  const takenAt = ({ frame }) => frame?.at ?? -Infinity;
  return seen
    .sort((a, b) => takenAt(a) - takenAt(b) || 0)
    .slice(0, MAX_NAMED)
    .map(({ topic, frame }) => ({ camera: topic, frame: frame?.sequence ?? null }));
}
