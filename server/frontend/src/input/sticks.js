// The joysticks on the screen: one for everything, at the left or at the right, or a left one to drive and a right one to
// turn. What a person likes is kept for each robot; one that goes sideways starts with two, as one cannot tell it to.

import { byTestId, part } from "../dom/page.js";
import { hints } from "../texts/inputs.js";

// What the position of a stick asks for.
const both = ({ up, left }) => ({ forward: up, left: 0, turn: left });
const drive = ({ up, left }) => ({ forward: up, left, turn: 0 });
const turn = ({ left }) => ({ forward: 0, left: 0, turn: left });

export class Sticks {
  // `kind` and `teleop` as of teleop.js; `choices` as of page.js, {two, right} of them are of the sticks.
  constructor(root, { kind, teleop, choices }) {
    this.kind = kind;
    this.teleop = teleop;
    this.choices = choices;
    this.asks = both;
    this.area = byTestId(root, "controls");
    this.main = this.joystick(byTestId(root, "joystick"), (at) => this.asks(at));
    this.second = this.joystick(byTestId(root, "joystick-turn"), turn);
    this.second.ways = "level";
    this.choice = byTestId(root, "two-sticks");
    this.choice.addEventListener("click", () => this.choose({ two: !this.two }));
    this.side = byTestId(root, "stick-right");
    this.side.addEventListener("click", () => this.choose({ right: !this.right }));
    this.show();
  }

  joystick(element, asks) {
    const input = element.dataset.testid;
    return new Joystick({
      element,
      knob: part(element, "knob"),
      accepts: () => this.teleop.accepts,
      onHold: (at, timestamp) => this.teleop.hold(input, asks(at), timestamp),
      onRelease: () => this.teleop.release(input),
    });
  }

  get two() {
    const { two } = this.choices.all;
    return typeof two === "boolean" ? two : this.kind === "holonomic";
  }

  get right() {
    return this.choices.all.right === true;
  }

  choose(chosen) {
    this.teleop.letGo(); // what is held would mean something else, or be elsewhere
    this.choices.keep(chosen);
    this.show();
  }

  show() {
    const { two, right } = this;
    const throttle = two && this.kind !== "holonomic";
    this.main.ways = throttle ? "upright" : "both";
    this.asks = two ? drive : both;
    this.second.element.hidden = !two;
    for (const { dataset } of [this.area, this.area.parentElement]) dataset.sticks = two ? "two" : right ? "right" : "one"; // and the deck
    this.choice.setAttribute("aria-pressed", String(two));
    this.side.setAttribute("aria-pressed", String(right));
    this.side.disabled = two;
    const words = hints.sticks;
    this.label(this.main, two ? words.two(this.kind) : words.one());
    this.label(this.second, words.turn(this.kind));
  }

  label({ element, ways }, words) {
    element.dataset.ways = ways;
    element.setAttribute("aria-label", words + hints.also(this.kind));
  }

  // `armed`: true, "free" when a press would take the control, false.
  arm(armed) {
    for (const { element } of [this.main, this.second]) element.dataset.armed = String(armed);
  }

  // Shows what is asked for by other inputs: `twist` in parts of the robot's own limits.
  follow({ forward, left, turn }) {
    const { two } = this;
    this.main.follow(two ? left : turn, forward);
    this.second.follow(two ? turn : 0, 0);
  }

  drop() {
    this.main.drop();
    this.second.drop();
  }
}

// A joystick for touch, pen and mouse as an input of teleop.js, on pointer events. It follows the one
// pointer that pressed it while driving was armed, so that a second finger elsewhere on the screen
// changes nothing.
// Which way a stick can go: a throttle only up and down, a rudder only to the sides.
const WAYS = { both: [1, 1], upright: [0, 1], level: [1, 0] };

const KNOB_TRAVEL = 81; // way of the knob to the rim, in percent of the knob, which is 38 % as wide as its stick (drive-deck.css)
const DEAD_ZONE = 0.08; // share of the radius in which a resting thumb moves nothing
const PRESSED = 1; // in PointerEvent.buttons: the main button, a finger or a pen's tip

export class Joystick {
  // `accepts()` says whether a press counts now. `onHold` gets where the stick is, as of `stick`, and its timestamp.
  constructor({ element, knob, accepts, onHold, onRelease }) {
    this.element = element;
    this.knob = knob;
    this.accepts = accepts;
    this.onHold = onHold;
    this.onRelease = onRelease;
    this.pointer = null;
    this.pressed = { centreX: 0, centreY: 0, radius: 0 };
    this.ways = "both"; // or "upright", "level"
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      element.addEventListener(end, (event) => this.up(event));
    }
    element.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  down(event) {
    if (this.pointer !== null || event.button !== 0 || !this.accepts()) return;
    event.preventDefault();
    this.element.setPointerCapture(event.pointerId); // first: it fails for a finger that is gone already
    this.pointer = event.pointerId;
    this.element.dataset.held = "true";
    this.pressed = this.measure();
    this.move(event);
  }

  move(event) {
    if (event.pointerId !== this.pointer) return;
    if (!(event.buttons & PRESSED)) return this.up(event); // a native menu or drag took the pointerup
    const { centreX, centreY, radius } = this.pressed;
    const [across, along] = WAYS[this.ways];
    const x = (event.clientX - centreX) * across;
    const y = (event.clientY - centreY) * along;
    this.place(x, y, radius);
    this.onHold(stick(x, y, radius), event.timeStamp);
  }

  // Once for each press: what moves the stick on the screen meanwhile must not steer.
  measure() {
    const { left, top, width, height } = this.element.getBoundingClientRect();
    const radius = (width - this.knob.offsetWidth) / 2;
    return { centreX: left + width / 2, centreY: top + height / 2, radius };
  }

  up(event) {
    if (event.pointerId !== this.pointer) return;
    this.drop();
    this.onRelease();
  }

  // Forgets the pointer: what it still does means nothing until it is pressed anew.
  drop() {
    if (this.pointer === null) return;
    const pointer = this.pointer;
    this.pointer = null;
    delete this.element.dataset.held;
    this.place(0, 0, 1);
    if (this.element.hasPointerCapture(pointer)) this.element.releasePointerCapture(pointer);
  }

  // `left` and `up` from -1 to 1, of another input; the driver of this one sees the finger.
  follow(left, up) {
    if (this.pointer !== null) return;
    const scale = KNOB_TRAVEL / Math.max(1, Math.hypot(left, up));
    this.knob.style.transform = left || up ? `translate(${-left * scale}%, ${-up * scale}%)` : "";
  }

  place(x, y, radius) {
    const scale = Math.min(1, radius / (Math.hypot(x, y) || 1));
    this.knob.style.transform = `translate(${x * scale}px, ${y * scale}px)`;
  }
}

// Turns an offset in pixels from the centre (y down) into {up, left} within the unit circle.
export function stick(x, y, radius) {
  const length = Math.hypot(x, y);
  const reach = Math.min(1, length / radius);
  if (!(reach > DEAD_ZONE)) return { up: 0, left: 0 };
  const strength = (reach - DEAD_ZONE) / (1 - DEAD_ZONE);
  return { up: ((0 - y) / length) * strength, left: ((0 - x) / length) * strength };
}
