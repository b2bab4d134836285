import assert from "node:assert/strict";
import { test } from "node:test";

import { requestedQuality, requestedSize } from "../../src/video/cameraTile.js";

const full = { width: 640, height: 480 };
const none = { width: null, height: null };
const size = (box, more = {}) => requestedSize({ full, set: none, box, turned: 0, ...more });

test("automatic is the settings' range, and a step is that alone", () => {
  assert.deepEqual(requestedQuality("auto", { quality_min: 30, quality_max: 60 }), { quality_min: 30, quality_max: 60 });
  assert.deepEqual(requestedQuality("50", {}), { quality_min: 50, quality_max: 50 });
  assert.deepEqual(requestedQuality("nonsense"), { quality_min: 20, quality_max: 80 });
});

test("a large place wants the camera's own size, small ones a half or a quarter", () => {
  assert.deepEqual(size({ width: 900, height: 700 }), none);
  assert.deepEqual(size({ width: 500, height: 375 }), none);
  assert.deepEqual(size({ width: 320, height: 240 }), { width: 320, height: 240 });
  assert.deepEqual(size({ width: 170, height: 130 }), { width: 160, height: 120 });
});

test("a few pixels more or less ask for nothing new", () => {
  assert.deepEqual(size({ width: 345, height: 260 }), size({ width: 310, height: 230 }));
});

test("a picture that is turned on its side is as wide as the place is high", () => {
  assert.deepEqual(size({ width: 170, height: 320 }, { turned: 90 }), { width: 320, height: 240 });
});

test("nothing is asked for before the camera's size or the place is known", () => {
  assert.deepEqual(size({ width: 100, height: 80 }, { full: null }), none);
  assert.deepEqual(size({ width: 0, height: 0 }), none);
});

test("the settings' size stands for the camera's own", () => {
  const set = { width: 800, height: 600 };
  assert.deepEqual(size({ width: 900, height: 700 }, { set }), set);
  assert.deepEqual(size({ width: 400, height: 300 }, { set, full: null }), { width: 400, height: 300 });
});
