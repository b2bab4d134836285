// W A S D and the arrow keys as an input of teleop.js. Keys go by their place on the keyboard, so that
// other layouts than QWERTY drive with the same fingers. Only a press that it sees while driving is armed
// counts, never the repeats of a key that is down already.

import { TYPING, matches } from "./page.js";

const DIRECTIONS = {
  KeyW: { forward: 1, turn: 0 },
  ArrowUp: { forward: 1, turn: 0 },
  KeyS: { forward: -1, turn: 0 },
  ArrowDown: { forward: -1, turn: 0 },
  KeyA: { forward: 0, turn: 1 },
  ArrowLeft: { forward: 0, turn: 1 },
  KeyD: { forward: 0, turn: -1 },
  ArrowRight: { forward: 0, turn: -1 },
};

// A key held elsewhere repeats into a window that gets the focus, and not every browser says so.
const FOCUS_MS = 300;

export class Keyboard {
  // `accepts()` says whether a press counts now. `onHold` gets the input and its moment. `onLetGo()` asks to let go of everything.
  constructor({ accepts, onHold, onRelease, onLetGo }) {
    Object.assign(this, { accepts, onHold, onRelease, onLetGo });
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
    if (matches(event.target, TYPING)) return;
    if (event.code in DIRECTIONS && !this.meantForSlider(event)) this.direction(event);
  }

  direction(event) {
    event.preventDefault();
    if (!this.isNewPress(event) || !this.accepts()) return;
    this.pressed.add(event.code);
    this.tell(event);
  }

  isNewPress({ repeat, timeStamp }) {
    return !repeat && timeStamp - this.focusedAt > FOCUS_MS;
  }

  up(event) {
    if (this.pressed.delete(event.code)) this.tell(event);
  }

  drop() {
    this.pressed.clear();
  }

  meantForSlider(event) {
    return event.code.startsWith("Arrow") && matches(event.target, "input[type=range]");
  }

  tell({ timeStamp }) {
    if (this.pressed.size === 0) this.onRelease();
    else this.onHold(direction(this.pressed), timeStamp);
  }
}

// Opposite keys cancel; two keys for one direction count once.
export function direction(codes) {
  const sum = { forward: new Set(), turn: new Set() };
  for (const code of codes) {
    sum.forward.add(DIRECTIONS[code].forward);
    sum.turn.add(DIRECTIONS[code].turn);
  }
  return { forward: total(sum.forward), turn: total(sum.turn) };
}

const total = (values) => [...values].reduce((a, b) => a + b, 0);
