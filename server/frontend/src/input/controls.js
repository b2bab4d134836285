// Joins sticks, keyboard, gamepad and limits to teleop.js, and lets go of all that is held when the page may be out of sight.

import { isSteered } from "../client/rosbridge.js";
import { TYPING, matches, part, setText } from "../pages/page.js";
import { limits as texts } from "../texts/common.js";
import { hints } from "../texts/inputs.js";
import { GamepadPanel } from "./gamepadPanel.js";
import { FieldFocus, Keyboard } from "./keyboard.js";
import { Sticks } from "./sticks.js";
import { Teleop } from "./teleop.js";

// `limits` as of settings.js; `kind`, `output`, `onTake` and `onWanted` as of teleop.js; `onStop()` comes from a gamepad's stop
// button. Gives {arm, watch, disarm, letGo, halt, useType, held}; `watch(free)` lets a press take the control, if that is free;
// `useType(type)` tells the type of the drive commands, which makes a car of a robot that nobody has set up as one.
export function setUpControls(root, { kind, limits: highest, output, onTake, onWanted, onStop }) {
  const limits = setUpLimits(root, highest);
  const inputs = [];
  const onDrop = () => inputs.forEach((input) => input.drop());
  const teleop = new Teleop({ output, onTake, onWanted, limits, kind, onDrop });
  const sticks = new Sticks(root, { kind, teleop });
  const gamepad = new GamepadPanel(root, { kind, teleop, limits, onStop });
  const keyboard = setUpKeyboard(root, teleop, kind);
  inputs.push(keyboard, sticks, gamepad);
  releaseOnFocusLoss(() => teleop.letGo());
  const show = (armed, free = false) => {
    sticks.arm(free ? "free" : armed);
    gamepad.free = free;
    keyboard.fields.onChange();
  };
  return {
    arm(armed) {
      teleop.arm(armed);
      show(armed);
    },
    watch(free) {
      teleop.watch();
      show(false, free);
    },
    disarm() {
      teleop.disarm();
      show(false);
    },
    letGo: () => teleop.letGo(),
    halt: () => teleop.halt(),
    useType: (type) => (teleop.kind = isSteered(type) ? "ackermann" : kind),
    held: () => teleop.held.size > 0,
  };
}

function setUpKeyboard(root, teleop, kind) {
  const fields = new FieldFocus({ onChange: () => showTaken(root, teleop.accepts && fields.taken) });
  const keyboard = new Keyboard({ teleop, kind, fields });
  part(root, "sideways-keys").hidden = kind !== "holonomic";
  keyboard.listen(window);
  fields.listen(window);
  return keyboard;
}

function showTaken(root, taken) {
  setText(part(root, "keys-taken"), taken ? hints.taken[taken] : "");
}

// How fast the inputs may ask for: the two sliders, and the higher limits of a gamepad's turbo button.
const STEPS = 20;

// In m/s and rad/s, as of teleop.js. `most` is the robot's own, beyond which nothing goes.
export class Limits {
  constructor({ maxLinear, maxAngular }) {
    this.most = { linear: maxLinear, angular: maxAngular };
    this.linear = maxLinear;
    this.angular = maxAngular;
    this.share = 1; // of the robot's own, with turbo
  }

  // Never slower than without.
  get turbo() {
    const { most, share } = this;
    return {
      linear: Math.max(this.linear, most.linear * share),
      angular: Math.max(this.angular, most.angular * share),
    };
  }
}

// The sliders go up to the robot's own limits and start there.
function setUpLimits(root, { maxLinear, maxAngular }) {
  const limits = new Limits({ maxLinear, maxAngular });
  setUpSlider(root, "linear", maxLinear, (value) => (limits.linear = value));
  setUpSlider(root, "angular", maxAngular, (value) => (limits.angular = value));
  return limits;
}

function setUpSlider(root, name, max, onValue) {
  const slider = part(root, `limit-${name}`);
  const output = part(root, `limit-${name}-value`);
  Object.assign(slider, { min: max / STEPS, max, step: max / STEPS, value: max });
  const apply = () => {
    onValue(Math.min(max, Number(slider.value)));
    output.textContent = texts[name](Number(slider.value).toFixed(2));
  };
  slider.addEventListener("input", apply);
  apply();
}

// Lets go of all that is held at every sign that nobody may be looking at the page, or that the browser
// may keep the release of a key or pointer for itself.
// What is let go must be pressed anew: none of these may ever start anything.
const ALWAYS = ["blur", "pagehide", "beforeprint", "fullscreenchange", "webkitfullscreenchange"];

export function releaseOnFocusLoss(letGo, { window, document } = globalThis) {
  const on = (target, names, /** @type {(event: any) => boolean} */ applies = () => true) => {
    for (const name of names) target.addEventListener(name, (event) => applies(event) && letGo());
  };
  on(window, ALWAYS);
  on(document, ["visibilitychange", "freeze", "resume"]);
  on(window, ["pointerdown", "pointermove"], opensMenu);
  on(window, ["contextmenu"], (event) => !event.defaultPrevented);
  on(window, ["focusin"], ({ target }) => matches(target, TYPING));
  on(window, ["dragstart"], refuse);
}

// Menus of the browser and lists of a <select> keep the keys until they close. A button that is pressed
// while another one is down comes as a pointermove.
const opensMenu = ({ button, target, type }) => button > 0 || (type === "pointerdown" && matches(target, "select"));

function refuse(event) {
  event.preventDefault();
  return true;
}
