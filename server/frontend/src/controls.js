// Joins keyboard, joystick, limits and the Halt button to teleop.js, and lets go whenever the page
// cannot be sure that the operator is looking at it.

import { Joystick } from "./joystick.js";
import { Keyboard } from "./keyboard.js";
import { byTestId, part } from "./page.js";
import { Teleop } from "./teleop.js";
import { limits as texts } from "./texts.js";

const STEPS = 20;
const DEFAULTS = { max_linear: 1.0, max_angular: 1.5 };

// `publish`, `mayQueue` and `onWanted` as of teleop.js. Gives the function that arms and disarms.
export function setUpControls(root, { settings, publish, mayQueue, onWanted }) {
  const stick = byTestId(root, "joystick");
  const limits = setUpLimits(root, { ...DEFAULTS, ...settings });
  const inputs = [];
  const onDrop = () => inputs.forEach((input) => input.drop());
  const teleop = new Teleop({ publish, mayQueue, onWanted, limits, onDrop });
  inputs.push(setUpKeyboard(teleop), setUpJoystick(teleop, stick));
  setUpHalt(teleop, byTestId(root, "halt"));
  letGoWhenUnwatched(teleop);
  return (armed) => {
    teleop.arm(armed);
    stick.dataset.armed = String(armed);
  };
}

function setUpKeyboard(teleop) {
  const keyboard = new Keyboard({
    onHold: (input) => teleop.hold("keyboard", input),
    onRelease: () => teleop.release("keyboard"),
    onHalt: () => teleop.halt(),
  });
  keyboard.listen(window);
  return keyboard;
}

function setUpJoystick(teleop, element) {
  return new Joystick({
    element,
    knob: part(element, "knob"),
    onHold: (input) => teleop.hold("joystick", input),
    onRelease: () => teleop.release("joystick"),
  });
}

// On the press, not on the click: a second finger beside the stick makes no click. What is left for
// click is the keyboard and assistive technology (detail 0).
function setUpHalt(teleop, button) {
  button.addEventListener("pointerdown", () => teleop.halt());
  button.addEventListener("click", ({ detail }) => detail === 0 && teleop.halt());
}

function letGoWhenUnwatched(teleop) {
  window.addEventListener("blur", () => teleop.letGo());
  window.addEventListener("pagehide", () => teleop.letGo());
  document.addEventListener("visibilitychange", () => document.hidden && teleop.letGo());
}

// The sliders go up to the robot's own limits and start there.
function setUpLimits(root, { max_linear, max_angular }) {
  const limits = {};
  setUpSlider(root, "linear", max_linear, (value) => (limits.linear = value));
  setUpSlider(root, "angular", max_angular, (value) => (limits.angular = value));
  return limits;
}

function setUpSlider(root, name, max, onValue) {
  const slider = part(root, `limit-${name}`);
  const output = part(root, `limit-${name}-value`);
  Object.assign(slider, { min: max / STEPS, max, step: max / STEPS, value: max });
  const apply = () => {
    onValue(Number(slider.value));
    output.textContent = texts[name](Number(slider.value).toFixed(2));
  };
  slider.addEventListener("input", apply);
  apply();
}
