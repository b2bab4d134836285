import assert from "node:assert/strict";
import { test } from "node:test";

import { CreditWindow } from "../../src/client/creditWindow.js";

// Has `count` frames come at this interval, each shown at once; gives how many are on their way then.
function underWay({ roundTripMs, intervalMs, codec = "h264", count = 60 }) {
  const credits = new CreditWindow();
  credits.grant(0);
  for (const answerMs of roundTripMs) credits.answered(answerMs);
  for (let number = 1; number <= count; number += 1) {
    credits.came(number * intervalMs, codec);
    credits.grant(1);
  }
  return credits.open;
}

test("two frames are on their way, and those that a long way holds", () => {
  for (const [roundTripMs, intervalMs, expected] of [
    [[5], 40, 2],
    [[38], 40, 3],
    [[38], 66, 2],
    [[200], 66, 5],
    [[900], 40, 8],
    [[NaN, -3], 40, 2],
  ]) {
    assert.equal(underWay({ roundTripMs, intervalMs }), expected, `${roundTripMs} ${intervalMs}`);
  }
  assert.equal(underWay({ roundTripMs: [38], intervalMs: 40, codec: "jpeg" }), 2);
});

test("answers that wait behind frames, and frames that a full line holds back, ask for no more", () => {
  assert.equal(underWay({ roundTripMs: [38, 400, 900], intervalMs: 100 }), 2);
});
