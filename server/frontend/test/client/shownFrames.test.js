import assert from "node:assert/strict";
import { test } from "node:test";

import { ShownFrames, oldestSeen } from "../../src/client/shownFrames.js";

function shown(...times) {
  const frames = new ShownFrames();
  times.forEach((shownAt, sequence) => frames.note({ sequence, at: shownAt - 100, shownAt }));
  return frames;
}

test("a frame is seen from when it is shown until the next one is", () => {
  const frames = shown(1000, 1100, 1200);
  assert.equal([1000, 1099, 1100, 1500].map((timestamp) => frames.seenAt(timestamp).sequence).join(), "0,0,1,2");
});

test("a frame is not seen before the display has it, and not at all if it was forgotten before", () => {
  const pictures = [];
  let clock = 1000;
  globalThis.requestAnimationFrame = (act) => pictures.push(act);
  const display = (ms) => ((clock += ms), pictures.splice(0).forEach((act) => act()));
  const frames = new ShownFrames({ now: () => clock });
  frames.draw({ sequence: 1, at: 900 });
  display(7);
  assert.equal(frames.seenAt(clock), null);
  frames.draw({ sequence: 2, at: 960 });
  display(17);
  assert.equal(frames.seenAt(1023), null);
  assert.deepEqual(frames.seenAt(1024), { sequence: 1, at: 900, shownAt: 1024 });
  frames.forget();
  display(17);
  assert.equal(frames.seenAt(clock), null);
});

test("what is kept is bounded, and can be forgotten", () => {
  const frames = shown(...Array.from({ length: 1000 }, (_, place) => place * 10));
  assert.ok(frames.frames.length <= 202);
  frames.forget();
  assert.equal(frames.seenAt(1e6), null);
});

test("of more views than a command can name, the oldest are named, and first what may be older still", () => {
  const views = Array.from({ length: 10 }, (_, place) => ({ topic: `/camera${place}`, frames: new ShownFrames() }));
  views.forEach(({ frames }, place) => place && frames.note({ sequence: place, at: 1000 - place, shownAt: 1000 }));
  views[5].frames.note({ sequence: 50, at: null, shownAt: 1001 });
  const named = oldestSeen(views, 1001).map(({ frame }) => frame);
  assert.deepEqual(named, [null, 50, 9, 8, 7, 6, 4, 3]);
});
