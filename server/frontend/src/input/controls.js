// Joins sticks, keyboard, gamepad and limits to teleop.js, and lets go of all that is held when the page may be out of sight.

import { isSteered } from "../client/rosbridge.js";
import { TYPING, matches, part, setText } from "../dom/page.js";
import { limits as texts } from "../texts/common.js";
import { hints } from "../texts/inputs.js";
import { GamepadPanel } from "./gamepadPanel.js";
import { FieldFocus, Keyboard } from "./keyboard.js";
import { Sticks } from "./sticks.js";
import { Teleop } from "../client/teleop.js";

// `limits` as of settings.js; `choices` as of page.js, of this robot's controls; `kind`, `output`, `onTake` and `onWanted` as of
// teleop.js; `onStop()` comes from a gamepad's stop button. Gives {arm, watch, disarm, letGo, halt, useType, held}; `watch(free)` lets a press take the control, if that is free;
// `useType(type)` tells the type of the drive commands, which makes a car of a robot that nobody has set up as one.
export function setUpControls(root, { kind, limits: highest, choices, output, onTake, onWanted, onStop }) {
  const limits = setUpLimits(root, highest, choices);
  const inputs = [];
  const onDrop = () => inputs.forEach((input) => input.drop());
  const show = (twist) => {
    onWanted(twist);
    const { linear, angular } = limits.most;
    sticks.follow({ forward: twist.forward / linear, left: twist.left / linear, turn: twist.turn / angular });
  };
  const teleop = new Teleop({ output, onTake, onWanted: show, limits, kind, onDrop });
  const sticks = new Sticks(root, { kind, teleop, choices });
  const gamepad = new GamepadPanel(root, { kind, teleop, limits, onStop });
  const keyboard = setUpKeyboard(root, { teleop, kind, onStep: (by) => limits.step(by), mayMove: () => teleop.armed || gamepad.free });
  inputs.push(keyboard, sticks, gamepad);
  releaseOnFocusLoss(() => teleop.letGo());
  const showArmed = (armed, free = false) => {
    sticks.arm(free ? "free" : armed);
    gamepad.free = free;
    keyboard.fields.onChange();
  };
  return {
    arm(armed) {
      teleop.arm(armed);
      showArmed(armed);
    },
    watch(free) {
      teleop.watch();
      showArmed(false, free);
    },
    disarm() {
      teleop.disarm();
      showArmed(false);
    },
    letGo: () => teleop.letGo(),
    halt: () => teleop.halt(),
    useType: (type) => (teleop.kind = isSteered(type) ? "ackermann" : kind),
    held: () => teleop.held.size > 0,
  };
}

// `mayMove()` says whether a new press of a key would move the robot.
function setUpKeyboard(root, { teleop, kind, onStep, mayMove }) {
  let stale = false;
  const fields = new FieldFocus({ onChange: () => showTaken(root, teleop.accepts && (fields.taken || (stale && mayMove() && "held"))) });
  const onStale = (any) => {
    stale = any;
    fields.onChange();
  };
  const keyboard = new Keyboard({ teleop, kind, fields, onStep, onStale, onKeys: (codes) => lightCaps(root, codes) });
  for (const key of ["KeyQ", "KeyE"]) root.querySelector(`[data-key=${key}]`).hidden = kind !== "holonomic";
  part(root, "sideways-keys").hidden = kind !== "holonomic";
  keyboard.listen(window);
  fields.listen(window);
  return keyboard;
}

function showTaken(root, taken) {
  setText(part(root, "keys-taken"), taken ? hints.taken[taken] : "");
}

// The caps beside the stick, which show what is held.
const CAPS = { ArrowUp: "KeyW", ArrowLeft: "KeyA", ArrowDown: "KeyS", ArrowRight: "KeyD", ShiftLeft: "Shift", ShiftRight: "Shift" };

function lightCaps(root, codes) {
  const lit = codes.map((code) => CAPS[code] ?? code);
  for (const cap of root.querySelectorAll("[data-key]")) cap.dataset.lit = String(lit.includes(cap.dataset.key));
}

// How fast the inputs may ask for: slow, normal or fast, the two sliders beside them, and the higher limits of a gamepad's
// turbo button.
const STEPS = 20;
const SPEEDS = [0.3, 0.6, 1]; // slow, normal and fast, as shares of the robot's own (drive/_deck.html)
const NORMAL = SPEEDS[1];
const SAME = 0.01;

// In m/s and rad/s, as of teleop.js. `most` is the robot's own, beyond which nothing goes.
export class Limits {
  // `onStep()` reports that a key for faster or slower is held, or no longer; `chosen` is what was chosen before, if anything.
  constructor({ maxLinear, maxAngular }, onStep = () => {}, chosen = {}) {
    this.most = { linear: maxLinear, angular: maxAngular };
    this.chosen = { linear: shareOf(chosen.linear), angular: shareOf(chosen.angular) };
    this.onStep = onStep;
    this.by = 0;
    this.share = 1; // of the robot's own, with turbo
  }

  get linear() {
    return this.most.linear * stepped(this.chosen.linear, this.by);
  }

  get angular() {
    return this.most.angular * stepped(this.chosen.angular, this.by);
  }

  // One step faster (1) or slower (-1) than chosen, as long as that is held.
  step(by) {
    if (by === this.by) return;
    this.by = by;
    this.onStep();
  }

  // Never slower than without.
  get turbo() {
    const { most, share } = this;
    return { linear: Math.max(this.linear, most.linear * share), angular: Math.max(this.angular, most.angular * share) };
  }
}

const shareOf = (share) => (share > 0 && share <= 1 ? share : NORMAL);

// The next of the three steps, from a share of the robot's own; there is none beyond the first and the last.
function stepped(share, by) {
  if (by > 0) return SPEEDS.find((step) => step > share + SAME) ?? share;
  if (by < 0) return SPEEDS.filter((step) => step < share - SAME).pop() ?? share;
  return share;
}

export function setUpLimits(root, highest, choices) {
  const buttons = [...root.querySelectorAll("[data-step]")];
  const limits = new Limits(highest, () => showSteps(buttons, limits), choices.group("speed"));
  const onChange = () => {
    choices.keep({ speed: limits.chosen });
    showSteps(buttons, limits);
  };
  const sliders = ["linear", "angular"].map((name) => setUpSlider(root, name, limits, onChange));
  for (const button of buttons) {
    button.addEventListener("click", () => sliders.forEach((choose) => choose(Number(button.dataset.step))));
  }
  showSteps(buttons, limits);
  return limits;
}

// Which step is chosen, and which one counts now.
function showSteps(buttons, { chosen, by }) {
  const is = (step, by) => Object.values(chosen).every((share) => Math.abs(stepped(share, by) - step) < SAME);
  for (const button of buttons) {
    const step = Number(button.dataset.step);
    button.setAttribute("aria-pressed", String(is(step, 0)));
    button.dataset.now = String(is(step, by));
  }
}

// The sliders go up to the robot's own limits. Gives what chooses a share of them.
function setUpSlider(root, name, limits, onChange) {
  const slider = part(root, `limit-${name}`);
  const output = part(root, `limit-${name}-value`);
  const max = limits.most[name];
  const show = () => {
    slider.value = limits.chosen[name] * max;
    output.textContent = texts[name](Number(slider.value));
    slider.setAttribute("aria-valuetext", output.textContent);
  };
  const choose = (share) => {
    limits.chosen[name] = share;
    show();
    onChange();
  };
  Object.assign(slider, { min: max / STEPS, max, step: max / STEPS });
  slider.addEventListener("input", () => choose(Math.min(1, Number(slider.value) / max)));
  show();
  return choose;
}

// Lets go of all that is held at every sign that nobody may be looking at the page, or that the browser
// may keep the release of a key or pointer for itself. A screen that is turned or zoomed moves the stick from under the finger.
// What is let go must be pressed anew: none of these may ever start anything.
const ALWAYS = ["blur", "pagehide", "beforeprint", "fullscreenchange", "webkitfullscreenchange", "orientationchange", "resize"];

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
