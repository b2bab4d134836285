import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { stopOnSpace } from "../../src/control/stopBar.js";

let stops, clicks, window;

// An element that stands inside exactly the given kind of element.
const inside = (kind) => ({
  closest: (selector) => selector.split(", ").includes(kind) || null,
  click: () => (clicks += 1),
});

function press(kind, more = {}, name = "keydown") {
  const event = new Event(name, { cancelable: true });
  Object.defineProperty(event, "target", { value: inside(kind) });
  window.dispatchEvent(Object.assign(event, { code: "Space", ...more }));
  return event.defaultPrevented;
}

beforeEach(() => {
  stops = 0;
  clicks = 0;
  window = new EventTarget();
  stopOnSpace(window, () => (stops += 1));
});

test("the space bar stops, once for each press, and does not scroll", () => {
  assert.equal(press("body"), true);
  assert.equal(press("body", { repeat: true }), true);
  assert.equal(stops, 1);
});

for (const kind of ["button", "select", "a", "input[type=range]", "input[type=checkbox]"]) {
  test(`on a ${kind} it stops and does not press it`, () => {
    assert.equal(press(kind), true);
    assert.equal(press(kind, {}, "keyup"), true);
    assert.equal(stops, 1);
  });
}

for (const kind of ["input:not([type=range]):not([type=checkbox])", "textarea", "[contenteditable]", "[data-hold]"]) {
  test(`in ${kind} it is what it always is`, () => {
    assert.equal(press(kind), false);
    assert.equal(stops, 0);
  });
}

test("other keys and shortcuts do not stop", () => {
  press("body", { code: "KeyW" });
  press("body", { ctrlKey: true });
  assert.equal(stops, 0);
});

test("Enter checks a checkbox, once for each press, and nothing else", () => {
  assert.equal(press("input[type=checkbox]", { code: "Enter" }), true);
  press("input[type=checkbox]", { code: "Enter", repeat: true });
  assert.equal(press("button", { code: "Enter" }), false);
  assert.deepEqual([clicks, stops], [1, 0]);
});
