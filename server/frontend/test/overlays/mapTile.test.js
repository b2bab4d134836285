import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { MapTile } from "../../src/overlays/mapTile.js";

let shown, tile;

beforeEach(() => {
  globalThis.requestAnimationFrame = () => 1;
  shown = [];
  const parts = { setAttribute() {}, addEventListener() {} };
  const element = { querySelector: () => parts };
  tile = (options = {}) => new MapTile(element, { world: { show: (seen) => shown.push(seen) }, ...options });
});

test("a small map that is not running takes nothing from the large one", () => {
  const [small, large] = [tile({ small: true }), tile()];
  large.start();
  assert.deepEqual(shown, [{ scan: true, path: true, map: true }]);
  small.stop();
  assert.equal(shown.length, 1);
});

test("a map that stops shows nothing any more", () => {
  const small = tile({ small: true });
  small.start();
  small.stop();
  assert.deepEqual(shown, [{ scan: false, path: true, map: false }, null]);
});
