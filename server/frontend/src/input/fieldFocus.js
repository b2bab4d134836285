// Which fields of the page keep keys from driving, and how a person gets them back. A menu or slider that a pointer used
// keeps none: the hand goes back to the keys that drive. One that Tab reached keeps the arrow keys, as who points at nothing
// moves it by them. A field for text keeps all keys, always.

import { TEXT, matches } from "../pages/page.js";

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

  // Who points at a label uses what it names.
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
