// Turns what the operator holds into drive commands: 20 Hz while anything is held, zero on release,
// then silence, so that the page never fights another controller. Pure but for its timer.
// It must never send anything but zero unless it is armed and an input is held that was pressed since then.

const PERIOD_MS = 50;
const ZEROS = 5; // one could be lost in a cut; five cover a quarter of a second
const GAP_MS = 500; // after as long without a command the robot has stopped by itself
const STILL = { forward: 0, turn: 0 };

export class Teleop {
  // `publish({forward, turn})` in m/s and rad/s; `mayQueue()` is false while old commands wait to be sent;
  // `onDrop()` tells the inputs that what they hold no longer counts. `now()` must go on while the
  // machine sleeps, which performance.now() does not everywhere.
  constructor({
    publish,
    limits,
    mayQueue = () => true,
    onDrop = () => {},
    onWanted = () => {},
    now = () => Date.now(),
  }) {
    Object.assign(this, { publish, limits, mayQueue, onDrop, onWanted, now });
    this.armed = false;
    this.held = new Map();
    this.zerosLeft = 0;
  }

  // Without a live connection nothing is accepted. What is held when one ends or begins must be let go
  // and pressed anew.
  arm(armed) {
    this.drop();
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
    else this.onDrop();
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
    this.sentAt = this.now();
    clearInterval(this.timer);
    this.timer = setInterval(() => this.send(), PERIOD_MS);
  }

  send() {
    if (this.held.size === 0 && this.zerosLeft === 0) clearInterval(this.timer);
    else if (this.stalled) this.dropStale();
    else if (this.held.size > 0) this.sendWanted();
    else this.sendZero();
  }

  // True when this page was frozen, this machine asleep or the network stuck since the last command.
  get stalled() {
    return Math.abs(this.now() - this.sentAt) > GAP_MS;
  }

  // The release may have been missed meanwhile, and a robot that stopped must not start by itself.
  dropStale() {
    if (this.held.size > 0) this.halt();
    else this.drop();
  }

  sendWanted() {
    const wanted = this.wanted;
    this.onWanted(wanted);
    if (this.mayQueue()) this.pass(wanted);
  }

  sendZero() {
    this.zerosLeft -= 1;
    this.onWanted(STILL);
    this.pass(STILL);
  }

  pass(twist) {
    this.sentAt = this.now();
    this.publish(twist);
  }
}

const clamp = (value) => Math.min(1, Math.max(-1, value)) + 0; // + 0 turns -0 into 0
