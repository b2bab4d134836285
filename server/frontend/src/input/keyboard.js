// W A S D and the arrow keys, Q and E for robots that go sideways, Shift and X for the speed, as an input of teleop.js.
// Keys go by their place on the keyboard, so that other layouts than QWERTY drive with the same fingers. Only a press that
// it sees while it counts does, never the repeats of a key that is down already, nor a key that is meant for a field of the
// page.

import { TEXT, matches } from "../dom/page.js";

const INPUT = "keyboard";
const FORWARD = { forward: 1 };
const BACK = { forward: -1 };
const TURN_LEFT = { turn: 1 };
const TURN_RIGHT = { turn: -1 };
const DIRECTIONS = {
  KeyW: FORWARD,
  ArrowUp: FORWARD,
  KeyS: BACK,
  ArrowDown: BACK,
  KeyA: TURN_LEFT,
  ArrowLeft: TURN_LEFT,
  KeyD: TURN_RIGHT,
  ArrowRight: TURN_RIGHT,
};
const SIDEWAYS = { KeyQ: { left: 1 }, KeyE: { left: -1 } };
const ALL = { ...DIRECTIONS, ...SIDEWAYS };
// Faster and slower while they are held. None of them is Ctrl, Alt or Meta: Ctrl+W closes the tab, and no page can prevent that.
const STEPS = { ShiftLeft: 1, ShiftRight: 1, KeyX: -1 };

/** @type {(report: any) => void} */
const NOTHING = () => {};

const FOCUS_MS = 300; // time after a window got the focus in which keys held elsewhere repeat into it, as not every browser says

export class Keyboard {
  // `teleop` and `kind` as of teleop.js, `fields` is a FieldFocus. `onKeys(codes)` tells which keys count now, `onStep(by)`
  // whether to go faster (1), slower (-1) or as chosen (0), `onStale(any)` whether a key is held that does not count, as through
  // a reload.
  constructor({ teleop, kind, fields = new FieldFocus(), onKeys = NOTHING, onStep = NOTHING, onStale = NOTHING }) {
    this.teleop = teleop;
    this.fields = fields;
    this.directions = kind === "holonomic" ? ALL : DIRECTIONS;
    this.onKeys = onKeys;
    this.onStep = onStep;
    this.onStale = onStale;
    this.stale = new Set();
    this.pressed = new Set();
    this.steps = new Set();
    this.focusedAt = -Infinity;
  }

  listen(target) {
    target.addEventListener("keydown", (event) => this.down(event));
    target.addEventListener("keyup", (event) => this.up(event));
    target.addEventListener("focus", ({ timeStamp }) => (this.focusedAt = timeStamp));
  }

  down(event) {
    // With a modifier it is a shortcut of the browser, which may also swallow the keyup of held keys.
    if (event.ctrlKey || event.metaKey || event.altKey) return this.teleop.letGo();
    this.dropLostShift(event);
    const { code } = event;
    if ((code in this.directions || code in STEPS) && !this.meantForField(event)) this.direction(event);
  }

  // Of two Shift keys some systems report one release alone.
  dropLostShift({ shiftKey }) {
    const lost = shiftKey === false ? ["ShiftLeft", "ShiftRight"].filter((code) => this.steps.delete(code)) : [];
    if (lost.length) this.notifyStep();
  }

  direction(event) {
    event.preventDefault();
    if (!this.isNewPress(event)) return this.noteStale(event);
    if (!this.teleop.accepts) return;
    if (event.code in STEPS) return this.step(event.code);
    this.pressed.add(event.code);
    this.notify(event);
  }

  noteStale({ code, repeat }) {
    if (!repeat || this.pressed.has(code) || this.steps.has(code)) return;
    this.stale.add(code);
    this.onStale(true);
  }

  step(code) {
    this.steps.add(code);
    this.notifyStep();
  }

  isNewPress({ repeat, timeStamp }) {
    return !repeat && timeStamp - this.focusedAt > FOCUS_MS;
  }

  up(event) {
    if (this.steps.delete(event.code)) this.notifyStep();
    this.dropLostShift(event);
    if (this.stale.delete(event.code)) this.onStale(this.stale.size > 0);
    if (this.pressed.delete(event.code)) this.notify(event);
  }

  drop() {
    this.pressed.clear();
    this.steps.clear();
    this.stale.clear(); // its release may come to nobody; while it is held, it repeats
    this.onStale(false);
    this.notifyStep();
  }

  // Not the repeats of a key that drives, whose hand took a slider meanwhile: they would push the limit to its end.
  meantForField(event) {
    return !this.pressed.has(event.code) && this.fields.keeps(event);
  }

  notify({ timeStamp }) {
    if (this.pressed.size === 0) this.teleop.release(INPUT);
    else this.teleop.hold(INPUT, direction(this.pressed), timeStamp);
    this.onKeys([...this.pressed, ...this.steps]);
  }

  notifyStep() {
    this.onStep(Math.sign([...this.steps].reduce((sum, code) => sum + STEPS[code], 0)));
    this.onKeys([...this.pressed, ...this.steps]);
  }
}

// Opposite keys cancel; two keys for one direction count once.
export function direction(codes) {
  const pressed = [...new Set([...codes].map((code) => ALL[code]))];
  const total = (name) => pressed.reduce((sum, key) => sum + (key[name] ?? 0), 0);
  return { forward: total("forward"), left: total("left"), turn: total("turn") };
}

// Which fields of the page keep keys from driving, and how a person gets them back. A menu or slider that a pointer used
// keeps none: the hand goes back to the keys that drive. One that Tab reached keeps the arrow keys, as a person without
// a pointer needs them. A field for text keeps all keys, always.
const SLIDER = "input[type=range]";
const MENU = "select";
const CHOICES = `${MENU}, ${SLIDER}`;

export class FieldFocus {
  // `onChange()` comes when `taken` may be another.
  constructor({ onChange = () => {} } = {}) {
    this.onChange = onChange;
    this.focused = null;
    this.pointed = null; // what a pointer used last
  }

  listen(window) {
    const on = (name, act) => window.addEventListener(name, act);
    on("pointerdown", ({ target }) => this.point(target));
    on("pointerup", () => this.leaveSlider());
    on("pointercancel", () => this.leaveSlider());
    on("keydown", (event) => this.key(event));
    on("focusin", ({ target }) => this.focus(target));
    on("focusout", () => this.focus(null));
  }

  // Whether a key is for the field in which it was pressed.
  keeps({ code, target }) {
    if (matches(target, TEXT)) return true;
    return code.startsWith("Arrow") && matches(target, CHOICES) && target !== this.pointed;
  }

  // What the field with the focus keeps: "text", "menu", "slider", or "" for nothing.
  get taken() {
    const { focused } = this;
    if (matches(focused, TEXT)) return "text";
    if (focused === this.pointed) return "";
    if (matches(focused, MENU)) return "menu";
    return matches(focused, SLIDER) ? "slider" : "";
  }

  // A press on a label uses what it names.
  point(target) {
    this.pointed = target?.closest?.("label")?.control ?? target;
    this.onChange();
  }

  // A menu's list is open now: it is left when something was chosen.
  leaveSlider() {
    if (matches(this.pointed, SLIDER)) this.pointed.blur();
  }

  key({ code, target }) {
    if (code === "Tab") this.point(null);
    if (code === "Escape" && matches(target, `${TEXT}, ${CHOICES}`)) target.blur();
  }

  focus(target) {
    this.focused = target;
    this.onChange();
  }
}
