// Learns a gamepad by having the person move it, one thing after the other: which axis is forward, which button is held
// to drive. Fed with what is seen; it neither drives nor shows anything. Pure.

const REST_MS = 400; // time without movement that counts as rest
const STEADY_MS = 150; // time for which a stick or button is held to be meant
const STILL = 0.08;
const PUSHED = 0.6;
const BACK = 0.3;
const OFF_CENTRE = 0.35; // greatest rest position of a stick: triggers rest at an end, some crosses beyond it
const MARGIN = 0.05; // width of the dead zone beyond the rest position of a worn stick
const END = 0.95; // least position of what rests at an end of its way
const CLEAR = 0.6; // share of the strongest push that no other axis may reach

const STICKS = ["forward", "left", "turn"];
const OPTIONAL = ["turbo", "stop"];

// What is asked for, in this order.
export const stepsOf = (kind) => ["forward", ...(kind === "holonomic" ? ["left"] : []), "turn", "enable", ...OPTIONAL];

export class Learner {
  // `onAsk(step, phase)` comes whenever the person has something else to do: "rest" (let go of everything), "move"
  // (the step's stick or button), "back" (let go of it). `onDone(learnt)` as of `madeOf`, with the least dead zone, `rest`.
  constructor({ steps, onAsk, onDone }) {
    this.onAsk = onAsk;
    this.onDone = onDone;
    this.steps = [...steps];
    this.learnt = {};
    this.used = { axes: new Set(), buttons: new Set() };
    this.ask("rest");
  }

  get step() {
    return this.steps[0];
  }

  get mayPass() {
    return OPTIONAL.includes(this.step);
  }

  // `sample` and `at` as of gamepad.js.
  see(sample, at) {
    if (!this.step) return;
    if (this.phase === "rest") this.rest(sample, at);
    else if (this.phase === "move") this.move(sample, at);
    else this.back(sample, at);
  }

  // Leaves out what a gamepad need not have.
  pass() {
    if (this.mayPass) this.next();
  }

  rest(sample, at) {
    if (!this.isAtRest(sample, at)) return;
    this.quiet = this.still;
    this.ask("move");
  }

  isAtRest({ axes, buttons }, at) {
    const moved = !this.still || axes.some((value, i) => Math.abs(value - this.still[i]) > STILL);
    if (moved || buttons.includes(true)) {
      this.still = axes;
      this.since = at;
    }
    return at - this.since >= REST_MS;
  }

  move(sample, at) {
    const control = STICKS.includes(this.step) ? this.pushed(sample.axes) : this.pressed(sample.buttons);
    if (control === null || control !== this.candidate) {
      this.candidate = control;
      this.since = at;
    } else if (at - this.since >= STEADY_MS) {
      this.accept(control, sample);
    }
  }

  accept(control, { axes }) {
    const isStick = STICKS.includes(this.step);
    this.used[isStick ? "axes" : "buttons"].add(control);
    this.learnt[this.step] = isStick ? { axis: control, sign: Math.sign(this.away(axes[control], control)) } : control;
    if (isStick) this.learnt.rest = Math.max(this.learnt.rest ?? 0, Math.abs(this.quiet[control]) + MARGIN);
    this.ask("back");
  }

  // The one axis that is clearly pushed, or null.
  pushed(axes) {
    const reach = axes.map((value, i) => (this.isStick(i) ? Math.abs(this.away(value, i)) : 0));
    const most = Math.max(...reach);
    const near = reach.filter((push) => push > most * CLEAR);
    return most >= PUSHED && near.length === 1 ? reach.indexOf(most) : null;
  }

  isStick(axis) {
    return Math.abs(this.quiet[axis]) <= OFF_CENTRE && !this.used.axes.has(axis);
  }

  away(value, axis) {
    return value - this.quiet[axis];
  }

  // The one button that is pressed and does nothing else yet, or null.
  pressed(buttons) {
    const down = [...buttons.keys()].filter((i) => buttons[i]);
    return down.length === 1 && !this.used.buttons.has(down[0]) ? down[0] : null;
  }

  // A device may say 0 of a trigger until it is touched, and from then on the end at which it rests.
  back(sample, at) {
    const { axes, buttons } = sample;
    const rests = this.isAtRest(sample, at);
    const away = [...axes.keys()].filter((i) => Math.abs(this.away(axes[i], i)) >= BACK);
    if (buttons.includes(true) || !away.every((i) => rests && !this.used.axes.has(i) && Math.abs(axes[i]) >= END)) return;
    this.quiet = this.quiet.map((rest, i) => (away.includes(i) ? axes[i] : rest));
    this.next();
  }

  next() {
    this.steps.shift();
    if (this.step) this.ask("move");
    else this.onDone(this.learnt);
  }

  ask(phase) {
    this.phase = phase;
    this.candidate = this.still = null;
    this.onAsk(this.step, phase);
  }
}
