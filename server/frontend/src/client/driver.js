// Drives for a program: repeats its last command at 20 Hz while the program repeats it, and ends with zeros.
// It must never send anything but zero that its program has not said within the last 0.3 s, nor start again by itself
// after it had to stop: then the program has to say zero first, as a person has to let go of the stick.

import { STILL, Teleop } from "./teleop.js";

const GOOD_FOR_MS = 300;
const NAME = "program";

// What is held is a twist already.
class Twists extends Teleop {
  get wanted() {
    return this.held.get(NAME).value;
  }
}

export class Driver {
  // `output` as of teleop.js; `timestamp()` and `now()` too, for tests.
  constructor(options) {
    this.released = true;
    this.moving = false;
    this.teleop = new Twists({ ...options, limits: null, onDrop: () => this.drop() });
  }

  // Whether the connection stands and drives.
  arm(armed) {
    this.teleop.arm(armed);
  }

  // {forward, left, turn} in m/s, m/s and rad/s, left positive; gives whether it counts.
  drive(command) {
    const twist = { ...STILL, ...command };
    check(twist);
    if (Object.values(twist).every((value) => value === 0)) return this.stopMoving();
    if (!this.teleop.armed) this.released = false;
    if (!this.released) return false;
    this.moving = true;
    this.teleop.hold(NAME, twist, this.teleop.timestamp(), GOOD_FOR_MS);
    return true;
  }

  stopMoving() {
    this.teleop.release(NAME);
    this.moving = false;
    this.released = true;
    return this.teleop.armed;
  }

  // For a page that nobody may be looking at.
  letGo() {
    this.teleop.letGo();
  }

  halt() {
    this.teleop.halt();
  }

  drop() {
    if (this.moving) this.released = false;
    this.moving = false;
  }
}

function check(twist) {
  for (const [name, value] of Object.entries(twist)) {
    if (!(name in STILL)) throw new TypeError(`cannot drive: ${name} is none of forward, left and turn`);
    if (!Number.isFinite(value)) throw new TypeError(`cannot drive: ${name} is ${value}, and must be a number`);
  }
}
