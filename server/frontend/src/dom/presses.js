// A press counts only on the control on which it began: one that appears, or comes to lie, under a finger that is down takes
// nothing from it, nor does one that gets the focus while a key is held. A double press is one: where a press removes a row, the
// second one must not remove what has moved up. What is aria-disabled takes none. Stop is left out: it acts on the press itself.
// Browsers make a click of the first finger alone; of another, as beside the one that holds the stick, it is made here.

import { matches } from "./page.js";

const CONTROL = "button, a[href], input, select, textarea, label, summary";
const STOP = ".stop, [data-testid^=stop]";
const ENTER = ["Enter", "NumpadEnter"];
export const DOUBLE_MS = 500; // time within which a press that is as near as this is the second of a double one
const NEAR_PX = 24; // least distance of two controls

export class Presses {
  constructor() {
    this.began = new Map(); // by the pointer: the control on which its press began
    this.newest = null;
    this.before = { control: null, x: NaN, y: NaN, at: NaN }; // the press before
  }

  // Before all other listeners of the page.
  watch(target) {
    const on = (name, act) => target.addEventListener(name, act, { capture: true });
    on("pointerdown", (event) => this.begin(event));
    on("pointerup", (event) => event.isPrimary || event.pointerType !== "touch" || this.clickFor(event));
    on("click", (event) => this.mayAct(event) || ignore(event));
    on("keydown", (event) => isHeld(event) && event.preventDefault());
  }

  begin({ pointerId, isPrimary, target, clientX: x, clientY: y, timeStamp: at }) {
    if (isPrimary) this.began.clear(); // the fingers of before have lifted
    const { before } = this;
    const isSecond = at - before.at < DOUBLE_MS && Math.hypot(x - before.x, y - before.y) < NEAR_PX;
    this.newest = (isSecond && before.control) || controlOf(target);
    this.before = { control: this.newest, x, y, at };
    this.began.set(pointerId, this.newest);
  }

  clickFor({ pointerId, clientX, clientY }) {
    const began = this.began.get(pointerId);
    const target = matches(began, STOP) ? began : document.elementFromPoint(clientX, clientY); // a finger that slips off stops, too
    const press = { detail: 1, pointerId, pointerType: "touch" };
    const control = controlOf(target);
    const acts = control && !control.matches(":disabled") && this.mayAct({ ...press, isTrusted: true, target });
    this.began.set(pointerId, null); // a browser that makes a click, too, adds none
    if (acts) target?.dispatchEvent(new PointerEvent("click", { ...press, bubbles: true, cancelable: true }));
  }

  // A click of a key, a script or assistive technology has no press of a pointer.
  mayAct({ detail, isTrusted, pointerId, target }) {
    if (detail === 0 || !isTrusted || matches(target, STOP)) return true;
    const control = controlOf(target);
    const began = this.began.has(pointerId) ? this.began.get(pointerId) : this.newest; // older browsers do not say which
    return control === null || (!isNew(control) && (control === began || isLabelOf(began, control)));
  }
}

const controlOf = (target) => target?.closest?.(CONTROL) ?? null;

const isLabelOf = (label, control) => Boolean(label) && label.control === control;

const isHeld = ({ repeat, code, target }) => repeat && ENTER.includes(code) && matches(target, "button, a, summary");

function ignore(event) {
  event.preventDefault();
  event.stopImmediatePropagation();
}

// Marks a control that is new: a press this soon meant what was there before. A test and assistive technology see that it does not
// act yet. What must not act by a key either asks `isNew` itself.
export const NEW_MS = 1200; // time for which a control is new
const ends = new WeakMap();

// Of one that replaced another.
export const markNew = (control) => mark(control, NEW_MS);

// Of a page that the first press of a double one led to.
export const markOpened = (control) => mark(control, DOUBLE_MS);

function mark(control, ms) {
  clearTimeout(ends.get(control));
  control.setAttribute("aria-disabled", "true");
  ends.set(
    control,
    setTimeout(() => control.removeAttribute("aria-disabled"), ms),
  );
}

export const isNew = (control) => control.getAttribute("aria-disabled") === "true";

const asked = new Set(); // by the page's own keys

// Asks for something once, unless it fails: of the second press of a double one the answer would be that it is done already.
// `ask()` gives an answer as of client/api.js; null for what was asked for already.
export async function askOnce(key, ask) {
  if (asked.has(key)) return null;
  asked.add(key);
  const answer = await ask();
  if (!answer.ok) asked.delete(key);
  return answer;
}

const SENT_MS = 3000; // time for which a form that was sent is not sent again

// The same of a form; its answer is another page.
export function sendOnce(page) {
  const sentAt = new WeakMap();
  page.addEventListener("submit", (event) => {
    const { target: form, timeStamp: at } = event;
    if (event.defaultPrevented || form.getAttribute("method") !== "post") return;
    if (at - (sentAt.get(form) ?? -Infinity) < SENT_MS) event.preventDefault();
    else sentAt.set(form, at);
  });
}
