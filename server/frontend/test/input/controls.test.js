import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Choices, byTestId } from "../../src/dom/page.js";
import { Limits, releaseOnFocusLoss, setUpControls, setUpLimits } from "../../src/input/controls.js";
import { FakeElement, inside } from "../fakes.js";

const HIGHEST = { maxLinear: 1, maxAngular: 2 };
const NORMAL = { linear: 0.6, angular: 0.6 };

// The limits by what was chosen, as shares of the robot's own, and the step that is held: faster, slower or none.
for (const [name, chosen, by, expected] of [
  ["limits start at the normal speed", {}, 0, [0.6, 1.2]],
  ["or as they were chosen before, except what is not a share", { linear: 0.3, angular: 7 }, 0, [0.3, 1.2]],
  ["a step is faster", NORMAL, 1, [1, 2]],
  ["or slower", NORMAL, -1, [0.3, 0.6]],
  ["never beyond the robot's own", { linear: 1, angular: 0.3 }, 1, [1, 1.2]],
  ["from each to the next", { linear: 1, angular: 0.3 }, -1, [0.6, 0.6]],
  ["never below slow", { linear: 0.05, angular: 0.05 }, -1, [0.05, 0.1]],
]) {
  test(`speeds: ${name}`, () => {
    const limits = new Limits(HIGHEST, undefined, chosen);
    limits.step(by);
    assert.deepEqual([limits.linear, limits.angular], expected);
    limits.step(0);
    assert.deepEqual(limits.turbo, limits.most, "turbo goes to the robot's own limits, and no further");
  });
}

test("turbo is a share of the robot's own limits, and never slower than without", () => {
  const limits = Object.assign(new Limits(HIGHEST), { chosen: { linear: 0.2, angular: 0.75 }, share: 0.5 });
  assert.deepEqual(limits.turbo, { linear: 0.5, angular: 1.5 });
});

test("a speed that is pressed is that of both limits", () => {
  const slow = Object.assign(new FakeElement(), { dataset: { step: "0.3" } });
  const root = Object.assign(new FakeElement(), { querySelectorAll: () => [slow] });
  const limits = setUpLimits(root, HIGHEST, new Choices("controls"));
  slow.dispatchEvent(new Event("click"));
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

const SECOND = { button: 2 };
const OF_WINDOW = ["blur", "pagehide", "beforeprint", "fullscreenchange", "orientationchange", "resize", "contextmenu"];

for (const [name, act, times] of [
  ...OF_WINDOW.map((event) => [event, () => dispatch(window, event), 1]),
  ...["visibilitychange", "freeze", "resume"].map((event) => [event, () => dispatch(document, event), 1]),
  ["another button than the main one", () => dispatch(window, "pointerdown", SECOND), 1],
  ["another button while the main one is down", () => dispatch(window, "pointermove", SECOND), 1],
  ["the main button, a finger", () => dispatch(window, "pointerdown", { button: 0 }), 0],
  ["a plain move", () => dispatch(window, "pointermove", { button: -1 }), 0],
  ["a list that opens", () => dispatch(window, "pointerdown", { button: 0, element: inside("select") }), 1],
  ["a field that gets the focus", () => dispatch(window, "focusin", { element: inside("textarea") }), 1],
  ["a slider that gets it", () => dispatch(window, "focusin", { element: inside("input[type=range]") }), 0],
]) {
  test(`${name} lets go ${times ? "" : "of nothing"}`, () => {
    act();
    assert.equal(count, times);
  });
}

// All controls of a page; keys go through the window, as all signs that nobody may be looking do.
function openControls(context, how = {}) {
  context.mock.timers.enable({ apis: ["setInterval"] });
  Object.assign(document, { hasFocus: () => true, activeElement: null });
  Object.assign(globalThis, { window, document, Option: FakeElement });
  const [root, done] = [new FakeElement(), []];
  byTestId(root, "controls").parentElement = new FakeElement();
  const output = { publish: ({ forward, turn }) => done.push([forward, turn]), mayQueue: true };
  const handlers = { output, onTake: () => done.push("take"), onWanted() {}, onStop() {} };
  const controls = setUpControls(root, { kind: "differential", limits: HIGHEST, choices: new Choices("controls"), ...handlers, ...how });
  return { root, controls, done };
}

const key = (name, code) => dispatch(window, name, { code, repeat: false });
const AHEAD = [0.6, 0];

for (const [name, act, done] of /** @type {[string, (controls: any) => void, any[]][]} */ ([
  ["a window that loses the focus lets go", () => dispatch(window, "blur"), [[0, 0]]],
  ["so does whoever lets go for the person", (controls) => controls.letGo(), [[0, 0]]],
  ["and a halt", (controls) => controls.halt(), [[0, 0]]],
  ["and video that is lost, on a link that stands", (controls) => controls.disarm(), [[0, 0]]],
  ["where the link is gone, nothing is sent", (controls) => controls.arm(false), []],
  ["nor where the page watches from now on", (controls) => controls.watch(false), []],
])) {
  test(`of all controls, ${name}, and what is held must be pressed anew`, (context) => {
    const { controls, done: all } = openControls(context);
    key("keydown", "KeyW");
    controls.arm(true);
    key("keydown", "KeyW");
    assert.deepEqual([all.splice(0), controls.held()], [[AHEAD], true]);
    act(controls);
    assert.deepEqual([all.splice(0), controls.held()], [done, false]);
    controls.arm(true);
    context.mock.timers.tick(50);
    assert.ok(all.every(([forward]) => forward === 0));
    key("keydown", "KeyA");
    assert.deepEqual(all.at(-1), [0, 1.2], "of the key that was held before, nothing is left");
  });
}

test("a press on a page that watches asks for the control, shows that it would, and sends nothing", (context) => {
  const { root, controls, done } = openControls(context);
  controls.watch(true);
  assert.equal(byTestId(root, "joystick").dataset.armed, "free");
  key("keydown", "KeyW");
  assert.deepEqual([done, controls.held()], [["take"], true]);
  controls.arm(true);
  assert.deepEqual([done.at(-1), byTestId(root, "joystick").dataset.armed], [AHEAD, "true"]);
});

for (const [name, how, keys, type, sent] of /** @type {[string, object, string[], string, number[]][]} */ ([
  ["a key for faster counts while it is held", {}, ["ShiftLeft", "KeyW"], "geometry_msgs/Twist", [1, 0]],
  ["a robot that takes steering angles turns as it goes", {}, ["KeyA"], "ackermann_msgs/AckermannDriveStamped", [0, 0]],
  ["any other turns where it stands", {}, ["KeyA"], "geometry_msgs/Twist", [0, 1.2]],
  ["what was set up as a car stays one", { kind: "ackermann" }, ["KeyA"], "geometry_msgs/Twist", [0, 0]],
])) {
  test(`of all controls, ${name}`, (context) => {
    const { controls, done } = openControls(context, how);
    controls.useType(type);
    controls.arm(true);
    for (const code of keys) key("keydown", code);
    assert.deepEqual(done, [sent]);
  });
}
