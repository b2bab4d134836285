// The joysticks on the screen: one for everything, or a left one to drive and a right one to turn. Which of the two a
// person likes is kept on the device; a robot that goes sideways starts with two, as one cannot tell it to.

import { Joystick } from "./joystick.js";
import { LocalStore } from "../pages/localStore.js";
import { byTestId, part } from "../pages/page.js";
import { hints } from "../texts/inputs.js";

const STORED_AS = "sticks";

// What the position of a stick asks for.
const both = ({ up, left }) => ({ forward: up, left: 0, turn: left });
const drive = ({ up, left }) => ({ forward: up, left, turn: 0 });
const turn = ({ left }) => ({ forward: 0, left: 0, turn: left });

export class Sticks {
  // `kind` as of mixing.js, `teleop` as of teleop.js.
  constructor(root, { kind, teleop, store = new LocalStore() }) {
    Object.assign(this, { kind, teleop, store });
    this.asks = both;
    this.area = byTestId(root, "controls");
    this.main = this.joystick(byTestId(root, "joystick"), (at) => this.asks(at));
    this.second = this.joystick(byTestId(root, "joystick-turn"), turn);
    this.second.ways = "level";
    this.choice = byTestId(root, "two-sticks");
    this.choice.addEventListener("click", () => this.choose(!this.two));
    this.show(this.remembered());
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

  remembered() {
    const two = this.store.read(STORED_AS);
    return typeof two === "boolean" ? two : this.kind === "holonomic";
  }

  choose(two) {
    this.teleop.letGo(); // what is held would mean something else
    this.store.write(STORED_AS, two);
    this.show(two);
  }

  show(two) {
    this.two = two;
    const throttle = two && this.kind !== "holonomic";
    this.main.ways = throttle ? "upright" : "both";
    this.asks = two ? drive : both;
    this.second.element.hidden = !two;
    this.area.dataset.sticks = two ? "two" : "one";
    this.choice.setAttribute("aria-pressed", String(two));
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

  drop() {
    this.main.drop();
    this.second.drop();
  }
}
