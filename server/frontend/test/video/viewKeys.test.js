import assert from "node:assert/strict";
import { test } from "node:test";

import { viewActionOf } from "../../src/video/viewKeys.js";

const within = (...selectors) => ({ closest: (asked) => selectors.some((one) => asked.includes(one)) || null });
const page = within();

test("C is the next camera, numbers name one, F is fullscreen", () => {
  assert.deepEqual(viewActionOf({ code: "KeyC", target: page }), { next: true });
  assert.deepEqual(viewActionOf({ code: "Digit3", target: page }), { nth: 2 });
  assert.deepEqual(viewActionOf({ code: "Numpad1", target: page }), { nth: 0 });
  assert.deepEqual(viewActionOf({ code: "KeyF", target: page }), { fullscreen: true });
});

test("keys that drive and stop, and any other, mean nothing here", () => {
  for (const code of ["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE", "ArrowUp", "Space", "Digit5", "Digit0"]) {
    assert.equal(viewActionOf({ code, target: page }), null);
  }
});

test("shortcuts, repeats and typed text are not for the picture", () => {
  assert.equal(viewActionOf({ code: "KeyC", ctrlKey: true, target: page }), null);
  assert.equal(viewActionOf({ code: "KeyC", metaKey: true, target: page }), null);
  assert.equal(viewActionOf({ code: "KeyC", repeat: true, target: page }), null);
  assert.equal(viewActionOf({ code: "Digit1", target: within("textarea") }), null);
});

test("a menu that has the focus keeps no letter and no number", () => {
  assert.deepEqual(viewActionOf({ code: "KeyC", target: within("select") }), { next: true });
});
