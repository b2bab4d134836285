// The drive page's Stop button, what is known of the stop, and the button to hold for its release.

import { api } from "../dom/calls.js";
import { byTestId, keepFocus, localTime, part, setText, TEXT, matches } from "../dom/page.js";
import { markNew } from "../dom/presses.js";
import { release as releaseTexts, stop as texts } from "../texts/common.js";
import { Stopping, sameStop } from "./stopping.js";

export class StopBar {
  // `halt()` ends what this page commands; `send(press)` says the stop on the page's own connection;
  // `onReleased(again)` comes when this page's person released the robot, `again` if to drive on.
  constructor(root, { robot, mac, halt, send, onReleased }) {
    this.sendRelease = (stopped) => api.release(robot, stopped, mac);
    this.halt = halt;
    this.onReleased = onReleased;
    this.element = byTestId(root, "stop-bar");
    this.status = byTestId(root, "control");
    this.release = byTestId(root, "release"); // drivers have one
    this.failure = "";
    this.offered = "idle";
    this.isKnown = true; // whether anything reports to this page what becomes of the stop
    this.asked = 0; // number of releases without an answer
    this.stopping = new Stopping({ send, post: (press) => api.stop(robot, press, mac), onChange: () => this.show() });
    this.listen(byTestId(root, "stop"));
  }

  // On the press, not on the click, which comes later. What is left for click is the keyboard and assistive technology (detail 0).
  listen(button) {
    button.addEventListener("pointerdown", () => this.press());
    button.addEventListener("click", ({ detail }) => detail === 0 && this.press());
    stopOnSpace(window, () => this.press());
    if (!this.release) return;
    this.hold = new Hold({ onDone: () => this.letGo(), onState: () => this.showHold() });
    this.hold.listen(this.release);
  }

  press() {
    if (!this.ended) this.failure = "";
    this.stopping.press(); // first of all: halting may wait for nothing, but might fail
    this.halt();
    this.hold?.cancel();
  }

  get ended() {
    return this.element.dataset.ended === "true";
  }

  receive({ stopped, guard }) {
    this.guard = guard;
    if (!stopped && !this.ended) this.failure = "";
    // The person who holds the button has not seen the other stop yet.
    if (!sameStop(this.stopping.stopped, stopped)) this.hold?.cancel();
    this.stopping.receive(stopped);
  }

  // This page may no longer ask the server for anything, so a stop can only be refused. It is sent all the same.
  end() {
    this.element.dataset.ended = "true";
    this.failure = texts.ended;
    this.show();
  }

  know(isKnown) {
    if (isKnown === this.isKnown) return;
    this.isKnown = isKnown;
    this.show();
  }

  show() {
    const { kind, by, at, detail } = this.stopping.shown;
    this.element.dataset.stop = kind;
    const shown = kind === "stopped" && !this.isKnown ? "unknown" : kind;
    const words = texts[shown]({ by, at: localTime(at), detail, guard: this.guard });
    setText(part(this.element, "stop-text"), [words, this.failure].join(" ").trim());
    this.showActions();
    if (this.release) this.showRelease();
  }

  showRelease() {
    const actions = [...part(this.element, "actions").querySelectorAll("[data-action]")];
    keepFocus(() => (this.release.hidden = !this.stopping.stopped), actions, this.status);
  }

  // What comes where the button to hold was acts on no press that was meant for that.
  showActions() {
    const actions = part(this.element, "actions");
    if (actions.hidden && !this.stopping.holds) actions.querySelectorAll("[data-action]").forEach(markNew);
    actions.hidden = this.stopping.holds;
  }

  // What holding the button brings: "idle", that the robot may be driven, or "again", that this page drives it again.
  offer(offered) {
    this.offered = offered;
    this.showHold();
  }

  showHold() {
    if (!this.hold) return;
    const { state } = this.hold;
    const shown = state === "idle" && this.asked ? "asked" : state;
    this.release.dataset.hold = shown;
    setText(part(this.release, "release-text"), releaseTexts[shown === "idle" ? this.offered : shown]);
  }

  async letGo() {
    const { stopped } = this.stopping;
    if (!stopped) return;
    const again = this.offered === "again"; // the news that it is released may come before the answer
    const answer = await this.askRelease(stopped);
    if (answer.ok) return this.onReleased(again);
    if (!this.stopping.stopped) return; // it is released: this answer was lost on the way, or is of a second hold
    this.failure = releaseTexts.failed(answer.detail);
    this.show();
  }

  async askRelease(stopped) {
    this.count(1);
    const answer = await this.sendRelease(stopped);
    this.count(-1);
    return answer;
  }

  count(more) {
    this.asked += more;
    this.showHold();
  }
}

// The space bar stops the robot wherever it is pressed on the drive page, except in a text that is being typed
// and on a button that is there to be held. It neither scrolls nor presses what has the focus; a checkbox, which no
// other key would check, takes Enter instead.
const HELD = "[data-hold]";
const CHECKBOX = "input[type=checkbox]";

export function stopOnSpace(target, onStop) {
  target.addEventListener("keydown", (event) => meant(event) && act(event, onStop), { capture: true });
  // Firefox presses a button on the keyup.
  target.addEventListener("keyup", (event) => meant(event) && event.preventDefault(), { capture: true });
  target.addEventListener("keydown", check);
}

function check(event) {
  const { code, repeat, target } = event;
  if (repeat || !["Enter", "NumpadEnter"].includes(code) || !matches(target, CHECKBOX)) return;
  event.preventDefault();
  target.click();
}

function act(event, onStop) {
  event.preventDefault();
  event.stopPropagation();
  if (!event.repeat) onStop();
}

function meant({ code, target, ctrlKey, altKey, metaKey, isComposing }) {
  if (code !== "Space" || ctrlKey || altKey || metaKey || isComposing) return false;
  return !matches(target, TEXT) && !matches(target, HELD);
}

// A button that acts only after it was held for a while, by pointer or keyboard: for what must be meant.
// Assistive technology cannot hold; its click (of no pointer and no key) has to come twice instead.
const HOLD_MS = 1000;
const LATE_MS = 300; // greatest delay of the timer: on a page that is later, a release may have been missed
const TWICE_MS = 5000;
const KEYS = ["Enter", "Space", "NumpadEnter"];

export class Hold {
  // `onDone()` comes at the end of the time; `onState("idle"|"held"|"once")` reports how far it is.
  /** @param {{onDone: () => void, onState?: (state: "idle" | "held" | "once") => void, now?: () => number}} options */
  constructor({ onDone, onState = () => {}, now = () => Date.now() }) {
    this.onDone = onDone;
    this.onState = onState;
    this.now = now;
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
