// Whether a person is at the list with a pointer, a finger or the keyboard: then nothing moves in it, so that a press
// meets the robot that it was meant for.

const TOUCH_MS = 3000; // after a finger has left: the next one is on its way

export class PointerPause {
  // `onEnd()` when nobody is at the list any more.
  constructor({ onEnd, now = () => performance.now() }) {
    Object.assign(this, { onEnd, now });
    this.pointed = false;
    this.touchedAt = -Infinity;
    this.lists = [];
  }

  listen(list) {
    this.lists.push(list);
    list.addEventListener("pointerover", ({ pointerType }) => this.point(pointerType !== "touch"));
    list.addEventListener("pointerleave", () => this.point(false));
    list.addEventListener("pointerdown", ({ pointerType }) => pointerType === "touch" && this.touch());
    list.addEventListener("focusout", () => setTimeout(() => this.check()));
  }

  point(pointed) {
    this.pointed = pointed;
    this.check();
  }

  touch() {
    this.touchedAt = this.now();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(), TOUCH_MS);
  }

  check() {
    if (!this.active) this.onEnd();
  }

  get active() {
    return this.pointed || this.now() - this.touchedAt < TOUCH_MS || this.focused;
  }

  get focused() {
    return this.lists.some((list) => list.querySelector(":focus-visible") !== null);
  }
}
