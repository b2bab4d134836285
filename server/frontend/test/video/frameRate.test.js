import assert from "node:assert/strict";
import { test } from "node:test";

import { FrameRate } from "../../src/video/cameraTile.js";

test("the rate is that of the last two seconds and falls when nothing comes", () => {
  const rate = new FrameRate();
  for (let at = 0; at <= 3000; at += 100) rate.hit(at);
  assert.equal(rate.perSecond(3000), 10);
  assert.equal(rate.perSecond(4000), 5);
  assert.equal(rate.perSecond(9000), 0);
});

test("one picture is no rate", () => {
  const rate = new FrameRate();
  rate.hit(0);
  assert.equal(rate.perSecond(10), null);
});
