// Joins keyboard, joystick and limits to teleop.js.

import { Joystick } from "./joystick.js";
import { Keyboard } from "./keyboard.js";
import { byTestId, part } from "./page.js";
import { Teleop } from "./teleop.js";
import { limits as texts } from "./texts.js";
import { letGoWhenUnsure } from "./unsure.js";

const STEPS = 20;

// `limits` as of settings.js; `publish`, `mayQueue` and `onWanted` as of teleop.js. Gives {arm, letGo, halt}.
export function setUpControls(root, { limits: highest, publish, mayQueue, onWanted }) {
  const stick = byTestId(root, "joystick");
  const limits = setUpLimits(root, highest);
  const inputs = [];
  const onDrop = () => inputs.forEach((input) => input.drop());
  const teleop = new Teleop({ publish, mayQueue, onWanted, limits, onDrop });
  inputs.push(setUpKeyboard(teleop), setUpJoystick(teleop, stick));
  letGoWhenUnsure(() => teleop.letGo());
  const arm = (armed) => {
    teleop.arm(armed);
    stick.dataset.armed = String(armed);
  };
  return { arm, letGo: () => teleop.letGo(), halt: () => teleop.halt() };
}

function setUpKeyboard(teleop) {
  const keyboard = new Keyboard({
    accepts: () => teleop.armed,
    onHold: (input, at) => teleop.hold("keyboard", input, at),
    onRelease: () => teleop.release("keyboard"),
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
    onHold: (input, at) => teleop.hold("joystick", input, at),
    onRelease: () => teleop.release("joystick"),
  });
}

// The sliders go up to the robot's own limits and start there.
function setUpLimits(root, { maxLinear, maxAngular }) {
  const limits = {};
  setUpSlider(root, "linear", maxLinear, (value) => (limits.linear = value));
  setUpSlider(root, "angular", maxAngular, (value) => (limits.angular = value));
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
