// The frames that one place of a page has shown lately, and which of them a person saw at a given time. Pure.
const KEPT_MS = 2000; // a command is never of an input that is longer ago

/** @typedef {{sequence: number, at: number, shownAt: number}} ShownFrame `at` is its timestamp; both times are on the page's clock */

export class ShownFrames {
  constructor() {
    this.frames = /** @type {ShownFrame[]} */ ([]);
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
    this.frames = [];
  }

  // The frame that was to be seen at this time; null before the first.
  /** @type {(timestamp: number) => ShownFrame | null} */
  seenAt(timestamp) {
    return this.frames.filter(({ shownAt }) => shownAt <= timestamp).at(-1) ?? null;
  }
}
