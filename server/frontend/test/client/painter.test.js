import assert from "node:assert/strict";
import { test } from "node:test";

import { Painter } from "../../src/client/painter.js";

function recordingCanvas() {
  const calls = [];
  const note =
    (name) =>
    (...values) =>
      calls.push([name, ...values.map((value) => (typeof value === "number" ? Math.round(value * 100) / 100 : value))]);
  const context = { setTransform: note("at"), rotate: note("rotate"), drawImage: (_, x, y) => note("draw")(x, y) };
  return { calls, width: 0, height: 0, getContext: () => context };
}

const imageOf = (size) => ({
  ...size,
  close() {
    this.closed = true;
  },
});

for (const [name, size] of [
  ["an ImageBitmap", { width: 64, height: 48 }],
  ["a VideoFrame", { displayWidth: 64, displayHeight: 48 }],
]) {
  test(`${name} is drawn at its own size and closed`, () => {
    const [canvas, image] = [recordingCanvas(), imageOf(size)];
    assert.deepEqual(new Painter(canvas).show(image), { width: 64, height: 48 });
    assert.deepEqual([canvas.width, canvas.height], [64, 48]);
    assert.deepEqual(canvas.calls, [
      ["at", 1, 0, 0, 1, 32, 24],
      ["rotate", 0],
      ["draw", -32, -24],
    ]);
    assert.equal(image.closed, true);
  });
}

test("a camera on its side is drawn upright", () => {
  const canvas = recordingCanvas();
  const painter = new Painter(canvas);
  painter.turned = 90;
  painter.show(imageOf({ width: 64, height: 48 }));
  assert.deepEqual([canvas.width, canvas.height], [48, 64]);
  assert.deepEqual(canvas.calls[1], ["rotate", 1.57]);
});
