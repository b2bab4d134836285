// Whether what a person presses counts, out of the seat and of what they can see. Pure.
// It must never let anything but zero through while driving is held, nor let what was held through it drive on.

export class Arming {
  // `controls` as of controls.js; `sight` as of sighthold.js; `send(twist, moment)` publishes a command.
  constructor({ controls, sight, send }) {
    Object.assign(this, { controls, sight, send });
    this.armed = false;
  }

  // `mayMove`: the link stands, this page drives, and the person has begun.
  update(mayMove) {
    if (!mayMove) this.disarm();
    else if (this.sight.held) this.hold();
    else if (!this.armed) this.arm();
  }

  arm() {
    this.armed = true;
    this.controls().arm(true);
  }

  // Nothing is said: there may be no link, or somebody else may drive.
  disarm() {
    this.armed = false;
    this.controls().arm(false);
  }

  // The link stands, so the robot is told to stand still.
  hold() {
    if (this.armed) this.controls().disarm();
    this.armed = false;
  }

  // Each command asks anew whether the person can see: a timer may be late.
  publish(twist, moment) {
    this.sight.check();
    const still = !twist.forward && !twist.left && !twist.turn;
    if (still || !this.sight.held) this.send(twist, moment);
  }
}
