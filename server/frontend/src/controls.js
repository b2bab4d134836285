// Joins keyboard, joystick, limits and the Halt button to teleop.js.

import { Joystick } from "./joystick.js";
import { Keyboard } from "./keyboard.js";
import { byTestId, part } from "./page.js";
import { Teleop } from "./teleop.js";
import { limits as texts } from "./texts.js";
import { letGoWhenUnsure } from "./unsure.js";

const STEPS = 20;
const DEFAULTS = { max_linear: 1.0, max_angular: 1.5 };

// `publish`, `mayQueue` and `onWanted` as of teleop.js. Gives {arm, letGo}.
export function setUpControls(root, { settings, publish, mayQueue, onWanted }) {
  const stick = byTestId(root, "joystick");
  const limits = setUpLimits(root, { ...DEFAULTS, ...settings });
  const inputs = [];
  const onDrop = () => inputs.forEach((input) => input.drop());
  const teleop = new Teleop({ publish, mayQueue, onWanted, limits, onDrop });
  inputs.push(setUpKeyboard(teleop), setUpJoystick(teleop, stick));
  setUpHalt(teleop, byTestId(root, "halt"));
  letGoWhenUnsure(() => teleop.letGo());
  const arm = (armed) => {
    teleop.arm(armed);
    stick.dataset.armed = String(armed);
  };
  return { arm, letGo: () => teleop.letGo() };
}

function setUpKeyboard(teleop) {
  const keyboard = new Keyboard({
    accepts: () => teleop.armed,
    onHold: (input) => teleop.hold("keyboard", input),
    onRelease: () => teleop.release("keyboard"),
    onHalt: () => teleop.halt(),
    onLetGo: () => teleop.letGo(),
  });
  keyboard.listen(window);
  return keyboard;
}

function setUpJoystick(teleop, element) {
  return new Joystick({
    element,
    knob: part(element, "knob"),
    accepts: () => teleop.armed,
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
