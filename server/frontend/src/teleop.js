// Turns what the operator holds into drive commands: 20 Hz while anything is held, zero on release,
// then silence, so that the page never fights another controller. Pure but for its timer.
// It must never send anything but zero unless an input is held at this moment and it is armed.

const PERIOD_MS = 50;
const ZEROS = 5; // one could be lost in a cut; five cover a quarter of a second
const STILL = { forward: 0, turn: 0 };

export class Teleop {
  // `publish({forward, turn})` in m/s and rad/s; `mayQueue()` is false while old commands wait to be sent;
  // `onDrop()` tells the inputs that what they hold no longer counts.
  constructor({ publish, limits, mayQueue = () => true, onDrop = () => {}, onWanted = () => {} }) {
    Object.assign(this, { publish, limits, mayQueue, onDrop, onWanted });
    this.armed = false;
    this.held = new Map();
    this.zerosLeft = 0;
  }

  // Without a live connection nothing is accepted; what is held then must be let go and held anew.
  arm(armed) {
    if (this.armed && !armed) this.drop();
    this.armed = armed;
  }

  // `input` names keyboard or joystick; values from -1 to 1, left and forward positive.
  hold(input, { forward, turn }) {
    if (!this.armed) return;
    const starting = this.held.size === 0;
    this.held.set(input, { forward, turn });
    if (starting) this.start();
  }

  release(input) {
    if (this.held.delete(input) && this.held.size === 0) this.zero();
  }

  // Ends any motion input at once. Zeroes also when nothing is held here.
  halt() {
    this.held.clear();
    this.onDrop();
    if (this.armed) this.zero();
  }

  // For a page that nobody may be looking at. Silent when nothing is held, since somebody else may drive.
  letGo() {
    if (this.held.size > 0) this.halt();
  }

  get wanted() {
    let forward = 0;
    let turn = 0;
    for (const input of this.held.values()) {
      forward += input.forward;
      turn += input.turn;
    }
    return {
      forward: clamp(forward) * this.limits.linear,
      turn: clamp(turn) * this.limits.angular,
    };
  }

  start() {
    this.zerosLeft = 0;
    this.restartTimer();
    this.send();
  }

  zero() {
    this.zerosLeft = ZEROS;
    this.restartTimer();
    this.send();
  }

  drop() {
    clearInterval(this.timer);
    this.held.clear();
    this.zerosLeft = 0;
    this.onDrop();
    this.onWanted(STILL);
  }

  restartTimer() {
    clearInterval(this.timer);
    this.timer = setInterval(() => this.send(), PERIOD_MS);
  }

  send() {
    if (this.held.size > 0) this.sendWanted();
    else if (this.zerosLeft > 0) this.sendZero();
    else clearInterval(this.timer);
  }

  sendWanted() {
    const wanted = this.wanted;
    this.onWanted(wanted);
    if (this.mayQueue()) this.publish(wanted);
  }

  sendZero() {
    this.zerosLeft -= 1;
    this.onWanted(STILL);
    this.publish(STILL);
  }
}

const clamp = (value) => Math.min(1, Math.max(-1, value)) + 0; // + 0 turns -0 into 0
