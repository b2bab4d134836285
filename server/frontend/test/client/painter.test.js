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

const image = {
  width: 64,
  height: 48,
  close() {
    this.closed = true;
  },
};

test("a frame is drawn at its own size and given back", async () => {
  const canvas = recordingCanvas();
  const size = await new Painter(canvas, { decode: async () => image }).show(new Uint8Array());
  assert.deepEqual([canvas.width, canvas.height, size], [64, 48, { width: 64, height: 48 }]);
  assert.deepEqual(canvas.calls, [
    ["at", 1, 0, 0, 1, 32, 24],
    ["rotate", 0],
    ["draw", -32, -24],
  ]);
  assert.equal(image.closed, true);
});

test("a camera on its side is drawn upright", async () => {
  const canvas = recordingCanvas();
  const painter = new Painter(canvas, { decode: async () => image });
  painter.turned = 90;
  await painter.show(new Uint8Array());
  assert.deepEqual([canvas.width, canvas.height], [48, 64]);
  assert.deepEqual(canvas.calls[1], ["rotate", 1.57]);
});

test("what is no image rejects and is not drawn", async () => {
  const canvas = recordingCanvas();
  const painter = new Painter(canvas, {
    decode: async () => {
      throw new Error("broken");
    },
  });
  await assert.rejects(painter.show(new Uint8Array()));
  assert.deepEqual(canvas.calls, []);
});
