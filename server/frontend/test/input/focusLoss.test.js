import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { releaseOnFocusLoss } from "../../src/input/controls.js";

let window, document, count;

beforeEach(() => {
  window = new EventTarget();
  document = new EventTarget();
  count = 0;
  releaseOnFocusLoss(() => (count += 1), { window, document });
});

function dispatch(target, name, more = {}) {
  const event = Object.assign(new Event(name, { cancelable: true }), more);
  if (more.element) Object.defineProperty(event, "target", { value: more.element });
  target.dispatchEvent(event);
  return event;
}

const element = (kind) => ({ closest: (selector) => selector.split(", ").includes(kind) || null });

for (const name of ["blur", "pagehide", "beforeprint", "fullscreenchange", "orientationchange", "contextmenu"]) {
  test(`${name} lets go`, () => {
    dispatch(window, name);
    assert.equal(count, 1);
  });
}

for (const name of ["visibilitychange", "freeze", "resume"]) {
  test(`${name} of the document lets go`, () => {
    dispatch(document, name);
    assert.equal(count, 1);
  });
}

test("a context menu that the joystick has refused changes nothing, as none opens", () => {
  window = new EventTarget();
  window.addEventListener("contextmenu", (event) => event.preventDefault());
  releaseOnFocusLoss(() => (count += 1), { window, document });
  dispatch(window, "contextmenu");
  assert.equal(count, 0);
});

test("a drag is refused and lets go", () => {
  assert.equal(dispatch(window, "dragstart").defaultPrevented, true);
  assert.equal(count, 1);
});

test("any button but the main one lets go, also while that one is down", () => {
  dispatch(window, "pointerdown", { button: 2 });
  dispatch(window, "pointermove", { button: 2 });
  dispatch(window, "pointerdown", { button: 1 });
  assert.equal(count, 3);
});

test("the main button, a finger and a plain move change nothing", () => {
  dispatch(window, "pointerdown", { button: 0 });
  dispatch(window, "pointermove", { button: -1 });
  assert.equal(count, 0);
});

test("a list that opens or a field that gets the focus lets go, a slider does not", () => {
  dispatch(window, "pointerdown", { button: 0, element: element("select") });
  dispatch(window, "focusin", { element: element("textarea") });
  assert.equal(count, 2);
  dispatch(window, "focusin", { element: element("input[type=range]") });
  assert.equal(count, 2);
});
