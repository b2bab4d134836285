// Decides whether input counts, from the drive mode and the video interlock. Pure.
// It must never let anything but zero through while driving is held, nor let what was held through it drive on.

export class Arming {
  // `controls` as of controls.js; `interlock` as of videoInterlock.js; `send(twist, timestamp)` publishes a command.
  constructor({ controls, interlock, send }) {
    Object.assign(this, { controls, interlock, send });
    this.armed = false;
  }

  // `mayMove`: the link stands, this page drives, and the person has begun. `watches`: a press is heard all the same, and
  // takes the control if `free`.
  update({ mayMove, watches = false, free = false }) {
    if (mayMove && this.interlock.held) this.hold();
    else if (mayMove) this.arm();
    else if (watches) this.watch(free);
    else this.disarm();
  }

  arm() {
    if (this.armed) return;
    this.armed = true;
    this.controls().arm(true);
  }

  watch(free) {
    this.armed = false;
    this.controls().watch(free);
  }

  // A link that is given up may yet deliver a last command.
  leave() {
    if (this.armed) this.controls().letGo();
  }

  // Nothing is said: there may be no link, or somebody else may drive.
  disarm() {
    this.armed = false;
    this.controls().arm(false);
  }

  // The link stands, so the robot is told to stand still.
  hold() {
    this.controls().disarm();
    this.armed = false;
  }

  // Each command asks anew whether the person can see: a timer may be late.
  publish(twist, timestamp) {
    this.interlock.check();
    const still = !twist.forward && !twist.left && !twist.turn;
    if (still || !this.interlock.held) this.send(twist, timestamp);
  }
}
