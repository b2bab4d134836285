// W A S D and the arrow keys, and Q and E for robots that go sideways, as an input of teleop.js. Keys go by their place on the keyboard, so that
// other layouts than QWERTY drive with the same fingers. Only a press that it sees while it counts
// does, never the repeats of a key that is down already.

import { FieldFocus } from "./fieldFocus.js";

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

// A key held elsewhere repeats into a window that gets the focus, and not every browser says so.
const FOCUS_MS = 300;

export class Keyboard {
  // `accepts()` says whether a press counts now, `sideways` whether Q and E do. `onHold` gets the input and its moment.
  // `onLetGo()` asks to let go of everything. `fields` as of fieldFocus.js.
  constructor({ sideways = false, accepts, onHold, onRelease, onLetGo, fields = new FieldFocus() }) {
    Object.assign(this, { accepts, onHold, onRelease, onLetGo, fields });
    this.directions = sideways ? ALL : DIRECTIONS;
    this.pressed = new Set();
    this.focusedAt = -Infinity;
  }

  listen(target) {
    target.addEventListener("keydown", (event) => this.down(event));
    target.addEventListener("keyup", (event) => this.up(event));
    target.addEventListener("focus", ({ timeStamp }) => (this.focusedAt = timeStamp));
  }

  down(event) {
    // With a modifier it is a shortcut of the browser, which may also swallow the keyup of held keys.
    if (event.ctrlKey || event.metaKey || event.altKey) return this.onLetGo();
    if (event.code in this.directions && !this.meantForField(event)) this.direction(event);
  }

  direction(event) {
    event.preventDefault();
    if (!this.isNewPress(event) || !this.accepts()) return;
    this.pressed.add(event.code);
    this.notify(event);
  }

  isNewPress({ repeat, timeStamp }) {
    return !repeat && timeStamp - this.focusedAt > FOCUS_MS;
  }

  up(event) {
    if (this.pressed.delete(event.code)) this.notify(event);
  }

  drop() {
    this.pressed.clear();
  }

  // Not the repeats of a key that drives, whose hand took a slider meanwhile: they would push the limit to its end.
  meantForField(event) {
    return !this.pressed.has(event.code) && this.fields.keeps(event);
  }

  notify({ timeStamp }) {
    if (this.pressed.size === 0) this.onRelease();
    else this.onHold(direction(this.pressed), timeStamp);
  }
}

// Opposite keys cancel; two keys for one direction count once.
export function direction(codes) {
  const pressed = [...new Set([...codes].map((code) => ALL[code]))];
  const total = (name) => pressed.reduce((sum, key) => sum + (key[name] ?? 0), 0);
  return { forward: total("forward"), left: total("left"), turn: total("turn") };
}
