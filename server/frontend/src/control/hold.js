// A button that acts only after it was held for a while, by pointer or keyboard: for what must be meant.
// Assistive technology cannot hold; its click (of no pointer and no key) has to come twice instead.

const HOLD_MS = 1000;
const LATE_MS = 300; // a timer that is later ran on a page that could not see a release
const TWICE_MS = 5000;
const KEYS = ["Enter", "Space", "NumpadEnter"];

export class Hold {
  // `onDone()` comes at the end of the time; `onState("idle"|"held"|"once")` tells how far it is.
  constructor({ onDone, onState = () => {}, now = () => Date.now() }) {
    Object.assign(this, { onDone, onState, now });
    this.state = "idle";
  }

  listen(button) {
    const on = (names, act) => names.forEach((name) => button.addEventListener(name, act));
    on(["pointerdown"], (event) => event.button === 0 && this.begin());
    on(["pointerup", "pointerleave", "pointercancel", "blur"], () => this.end());
    on(["contextmenu"], (event) => event.preventDefault()); // a long press on a phone is ours
    on(["keydown"], (event) => this.key(event));
    on(["keyup"], (event) => KEYS.includes(event.code) && this.end());
    on(["click"], (event) => this.click(event));
  }

  begin() {
    this.set("held");
    const due = this.now() + HOLD_MS;
    this.timer = setTimeout(() => (Math.abs(this.now() - due) > LATE_MS ? this.end() : this.finish()), HOLD_MS);
  }

  end() {
    if (this.state === "held") this.set("idle");
  }

  // What it was held for is no longer so: it has to be pressed anew.
  cancel() {
    if (this.state !== "idle") this.set("idle");
  }

  finish() {
    this.set("idle");
    this.onDone();
  }

  // The click that the browser makes of a key must not count as one of assistive technology.
  key(event) {
    if (!KEYS.includes(event.code)) return;
    event.preventDefault();
    if (!event.repeat && this.state !== "held") this.begin();
  }

  click({ detail, pointerType }) {
    if (detail !== 0 || pointerType) return;
    if (this.state === "once") return this.finish();
    this.set("once");
    this.timer = setTimeout(() => this.set("idle"), TWICE_MS);
  }

  set(state) {
    clearTimeout(this.timer);
    this.state = state;
    this.onState(state);
  }
}
