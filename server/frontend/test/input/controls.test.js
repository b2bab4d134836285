import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Limits, releaseOnFocusLoss, setUpLimits } from "../../src/input/controls.js";

let limits;

beforeEach(() => {
  limits = new Limits({ maxLinear: 1, maxAngular: 2 });
});

test("limits start at the normal speed", () => {
  assert.deepEqual([limits.linear, limits.angular], [0.6, 1.2]);
});

test("limits start as they were chosen before, but for what is no share", () => {
  const { chosen } = new Limits({ maxLinear: 1, maxAngular: 2 }, undefined, { linear: 0.3, angular: 7 });
  assert.deepEqual(chosen, { linear: 0.3, angular: 0.6 });
});

test("a step is faster or slower than chosen while it is held, and never beyond the robot's own or below slow", () => {
  const speeds = (by) => {
    limits.step(by);
    return [limits.linear, limits.angular];
  };
  assert.deepEqual(
    [speeds(1), speeds(-1), speeds(0)],
    [
      [1, 2],
      [0.3, 0.6],
      [0.6, 1.2],
    ],
  );
  limits.chosen = { linear: 1, angular: 0.3 };
  assert.deepEqual(
    [speeds(1), speeds(-1)],
    [
      [1, 1.2],
      [0.6, 0.6],
    ],
  );
  limits.chosen = { linear: 0.05, angular: 0.05 };
  assert.deepEqual(speeds(-1), [0.05, 0.1]);
});

test("turbo is a share of the robot's own limits, and never slower than without", () => {
  Object.assign(limits, { chosen: { linear: 0.2, angular: 0.75 }, share: 0.5 });
  assert.deepEqual(limits.turbo, { linear: 0.5, angular: 1.5 });
});

test("turbo never goes beyond the robot's own limits", () => {
  limits.step(1);
  assert.deepEqual(limits.turbo, limits.most);
});

// As much of the page as the speeds need.
function speedsOnPage() {
  const element = (dataset) => Object.assign(new EventTarget(), { dataset, setAttribute() {} });
  const buttons = ["0.3", "0.6", "1"].map((step) => element({ step }));
  const others = new Map();
  const root = {
    querySelectorAll: () => buttons,
    querySelector: (selector) => others.get(selector) ?? others.set(selector, element({})).get(selector),
  };
  return { slow: buttons[0], limits: setUpLimits(root, { maxLinear: 1, maxAngular: 2 }, { all: {}, keep() {} }) };
}

test("a finger beside the one on the stick, which makes no click, chooses a speed as well", () => {
  const { slow, limits } = speedsOnPage();
  slow.dispatchEvent(Object.assign(new Event("pointerup"), { isPrimary: false, pointerType: "touch" }));
  assert.deepEqual([limits.linear, limits.angular], [0.3, 0.6]);
});

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

const inside = (kind) => ({ closest: (selector) => selector.split(", ").includes(kind) || null });

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
  dispatch(window, "pointerdown", { button: 0, element: inside("select") });
  dispatch(window, "focusin", { element: inside("textarea") });
  assert.equal(count, 2);
  dispatch(window, "focusin", { element: inside("input[type=range]") });
  assert.equal(count, 2);
});
