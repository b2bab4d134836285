// The robots as elements, cards or rows of a table: one list, in order, with what is filtered out hidden.
// The markup is the server's; cards.js fills it in. What changes is gathered, and nothing moves under a person's hand.

import { arrange } from "../dom/keyedRows.js";
import { setIfOther } from "../dom/page.js";
import { fillCard, newCard } from "./cards.js";

export class RobotList {
  // `container` holds the elements, `template` makes one for a robot that has none yet; `onNew(element, name)` for each.
  // `make(template, robot)` and `fill(element, robot)` know the markup.
  constructor({ container, template, onNew, make = newCard, fill = fillCard }) {
    this.container = container;
    this.template = template;
    this.onNew = onNew;
    this.make = make;
    this.write = fill;
    this.elements = new Map([...container.children].map((element) => [element.dataset.robot, element]));
    for (const [name, element] of this.elements) onNew(element, name);
  }

  // Makes what is missing; a robot that is new comes last until the next `arrange`.
  fill(robot, shown) {
    if (!this.elements.has(robot.name)) this.add(robot, shown);
    this.write(this.elements.get(robot.name), robot);
  }

  add(robot, shown) {
    const element = this.make(this.template, robot);
    element.hidden = !shown;
    this.elements.set(robot.name, element);
    this.container.append(element);
    this.onNew(element, robot.name);
  }

  // `paused`: nothing may move, so what goes leaves its place empty.
  remove(name, paused) {
    const element = this.elements.get(name);
    this.elements.delete(name);
    if (paused && element) vacate(element);
    else element?.remove();
  }

  // `names` in order, each with an element; `shown` says which of them are.
  arrange(names, shown) {
    for (const left of this.container.querySelectorAll("[data-left]")) left.remove();
    const focused = /** @type {HTMLElement | null} */ (document.activeElement);
    arrange(
      this.container,
      names.map((name) => this.elements.get(name)),
    );
    for (const name of names) setIfOther(this.elements.get(name), "hidden", !shown.has(name));
    // An element that moves loses the keyboard focus.
    if (focused !== document.activeElement && this.container.contains(focused)) focused?.focus({ preventScroll: true });
  }
}

function vacate(element) {
  element.dataset.left = "";
  for (const name of ["robot", "testid"]) delete element.dataset[name];
  element.setAttribute("aria-hidden", "true");
  element.inert = true;
}

// Gathers changes until the next frame, and calls for what is costly seldom. Pure except for its timers.
export class Batch {
  // `apply(names)` gets what changed since the last time, once a frame.
  constructor(apply) {
    this.apply = apply;
    this.names = new Set();
  }

  add(name) {
    if (this.names.size === 0) requestAnimationFrame(() => this.flush());
    this.names.add(name);
  }

  flush() {
    const { names } = this;
    this.names = new Set();
    if (names.size > 0) this.apply(names);
  }
}

// Gives the function that calls `act` at most once in `everyMs`: at once if it is long ago, else at the end of the time.
export function throttled(act, everyMs, now = () => performance.now()) {
  let actedAt = -Infinity;
  /** @type {number | undefined} */
  let timer;
  const run = () => {
    timer = undefined;
    actedAt = now();
    act();
  };
  return () => {
    if (timer !== undefined) return;
    const wait = actedAt + everyMs - now();
    if (wait <= 0) run();
    else timer = setTimeout(run, wait);
  };
}

// Whether a person is at the list with a pointer, a finger or the keyboard: then nothing moves in it, so that a press
// meets the robot that it was meant for.
const TOUCH_MS = 3000; // time for which a touch counts after the finger has left: the next one is on its way

export class PointerPause {
  // `onEnd()` when nobody is at the list any more.
  constructor({ onEnd, now = () => performance.now() }) {
    this.onEnd = onEnd;
    this.now = now;
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
