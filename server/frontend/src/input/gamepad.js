// A gamepad as an input of teleop.js. It drives only while its enable button is held, and only by a press that was
// seen while it counted: one that is stuck, or was held through a drop, a loss or a late look, moves nothing until it
// is released and pressed anew. A stick counts once it was seen at its centre: one that rests elsewhere drives nothing.
// Its stop button stops whether it may drive or not. Pure.

// Time limit between two polls: in a longer gap a release may have been missed.
export const MAX_POLL_GAP_MS = 250;

export class Gamepad {
  // `accepts()` says whether driving counts now. `onHold` gets the input and the timestamp of the poll; `onStop()` comes
  // with each press of the stop button; `onState` reports "unknown" (no profile), "off" (nothing counts now),
  // "stuck" (enable must be released first), "uncentred" (a stick drives nothing yet), "ready", "driving" or "turbo".
  // `onRefused()` comes with a press of enable that does not count now.
  constructor({ accepts, ...handlers }) {
    this.accepts = accepts;
    this.handlers = handlers;
    this.profile = null;
    this.centred = new Set(); // the axes that were seen in the dead zone
    this.forget();
  }

  // `profile` as `usualProfile` gives it; null for a device that nobody knows.
  use(profile) {
    this.release();
    this.profile = profile;
    this.centred.clear();
  }

  // `sample` is {axes, buttons} of now, by the clock of event.timeStamp: positions, and true for what is pressed.
  see(sample, at) {
    if (at - this.seenAt > MAX_POLL_GAP_MS) this.release();
    this.seenAt = at;
    if (!this.profile) return this.handlers.onState("unknown");
    this.watchStop(sample.buttons);
    this.watchCentres(sample.axes);
    this.watchEnable(sample, at);
    this.handlers.onState(this.state(sample.buttons));
  }

  // The device is gone.
  forget() {
    this.release();
    this.seenAt = -Infinity;
    this.stopDown = false;
  }

  // What is held means nothing until it is pressed anew.
  drop() {
    this.held = false;
    this.ready = false;
  }

  release() {
    const { held } = this;
    this.drop();
    if (held) this.handlers.onRelease();
  }

  watchStop(buttons) {
    const down = this.profile.stop !== null && buttons[this.profile.stop];
    const pressed = down && !this.stopDown;
    this.stopDown = down;
    if (pressed) this.handlers.onStop();
  }

  watchCentres(axes) {
    const { deadZone } = this.profile;
    for (const axis of this.sticks) if (Math.abs(axes[axis]) <= deadZone) this.centred.add(axis);
  }

  get sticks() {
    return MOTIONS.flatMap((name) => this.profile[name]?.axis ?? []);
  }

  watchEnable(sample, at) {
    const down = sample.buttons[this.profile.enable];
    const pressed = down && this.ready;
    if (!pressed || !this.accepts()) {
      this.release();
      this.ready = !down;
      if (pressed) this.handlers.onRefused?.();
      return;
    }
    this.held = true;
    const axes = sample.axes.map((value, axis) => (this.centred.has(axis) ? value : 0));
    const input = readInput(this.profile, { ...sample, axes });
    this.turbo = input.turbo;
    this.handlers.onHold(input, at);
  }

  state(buttons) {
    if (!this.accepts()) return "off";
    if (buttons[this.profile.enable] && !this.held) return "stuck";
    if (this.sticks.some((axis) => !this.centred.has(axis))) return "uncentred";
    if (!this.held) return "ready";
    return this.turbo ? "turbo" : "driving";
  }
}

// What a gamepad's sticks and buttons do: `{version, axes, buttons, mapping, forward, left, turn, enable, turbo, stop,
// deadZone}`. `axes` and `buttons` are how many the device has, `mapping` is the browser's order of them; forward, left (or
// null) and turn are {axis, sign, invert}, the sign that of the axis when the stick is pushed forward or left; enable, turbo
// and stop are buttons, the last two may be null. Pure.
export const MOTIONS = ["forward", "left", "turn"];
export const DEAD_ZONE = { least: 0.05, usual: 0.15, most: 0.4 };

const VERSION = 1;
const BUTTONS = { enable: 4, turbo: 5, stop: 1 }; // of the standard mapping: LB, RB, B
const LEFT_STICK = [0, 1];
const RIGHT_STICK = [2, 3];

// Of a device that the browser knows ("standard" mapping) and that has all that it takes; null for others, which must be learnt.
export function usualProfile({ mapping, axes, buttons }, kind) {
  if (mapping !== "standard" || axes < RIGHT_STICK[1] + 1) return null;
  if (buttons <= Math.max(...Object.values(BUTTONS))) return null;
  const [across, along] = LEFT_STICK;
  const sideways = kind === "holonomic";
  const learnt = {
    forward: towards(along),
    left: sideways ? towards(across) : null,
    turn: towards(sideways ? RIGHT_STICK[0] : across),
    ...BUTTONS,
  };
  return madeOf(learnt, { axes, buttons, mapping });
}

const towards = (axis) => ({ axis, sign: -1 }); // browsers count down and right as positive

// `learnt` gives forward, left, turn as {axis, sign} and enable, turbo, stop; `rest`: what these sticks show untouched.
export function madeOf(learnt, { axes, buttons, mapping }) {
  const { enable, turbo = null, stop = null, rest = 0 } = learnt;
  const deadZone = Math.min(DEAD_ZONE.most, Math.max(DEAD_ZONE.usual, rest));
  const profile = { version: VERSION, axes, buttons, mapping, enable, turbo, stop, deadZone };
  for (const name of MOTIONS) profile[name] = learnt[name] ? { invert: false, ...learnt[name] } : null;
  return profile;
}

// Whether what was kept is a profile, and of a device with as many axes and buttons in the same order: the same one may
// come in another, by cable or by another version of the browser.
export function fits(profile, { axes, buttons, mapping }) {
  if (profile?.version !== VERSION || profile.mapping !== mapping) return false;
  if (profile.axes !== axes || profile.buttons !== buttons) return false;
  return motionsFit(profile, axes) && buttonsFit(profile, buttons) && isDeadZone(profile.deadZone);
}

const motionsFit = ({ forward, left, turn }, axes) =>
  isMotion(forward, axes) && isMotion(turn, axes) && (left === null || isMotion(left, axes));

const isMotion = (motion, axes) => isBelow(motion?.axis, axes) && Math.abs(motion.sign) === 1 && typeof motion.invert === "boolean";

const buttonsFit = ({ enable, turbo, stop }, buttons) =>
  isBelow(enable, buttons) && [turbo, stop].every((button) => button === null || isBelow(button, buttons));

const isBelow = (number, end) => Number.isInteger(number) && number >= 0 && number < end;

const isDeadZone = (value) => value >= DEAD_ZONE.least && value <= DEAD_ZONE.most;

// What the sticks ask for, as of teleop.js.
export function readInput(profile, { axes, buttons }) {
  const [forward, left, turn] = MOTIONS.map((name) => pushed(profile[name], axes, profile.deadZone));
  return { forward, left, turn, turbo: profile.turbo !== null && buttons[profile.turbo] };
}

// From -1 to 1; strength grows from the dead zone's rim without a step. What is not a number is rest.
function pushed(motion, axes, deadZone) {
  const value = motion ? axes[motion.axis] : 0;
  const reach = Math.min(1, Math.abs(value));
  if (!(reach > deadZone)) return 0;
  const strength = (reach - deadZone) / (1 - deadZone);
  return strength * Math.sign(value) * motion.sign * (motion.invert ? -1 : 1);
}

// Looks at the gamepad once in each frame that the browser draws, while there is one; a page that nobody sees draws
// none. Browsers show a gamepad only after a button of it was pressed.
const PRESSED = 0.5; // value from which a trigger counts as pressed: some browsers never say so

export class GamepadLoop {
  // `onFound({id, mapping, axes, buttons})` comes with the device that is polled from now on (axes, buttons: how
  // many), `onSeen({axes, buttons}, at)` with each look, `onLost()` when that device is gone, `onAll([{index, chosen, ...device}])`
  // with all that there are, `onOther(index, {axes, buttons}, at)` with each look at one that is not chosen. `rank(device)`: of several devices the one with the highest is polled, unless a person chose;
  // one with a higher rank that comes later takes over while `mayChange()`.
  constructor({
    pads = browserPads,
    frame = (act) => requestAnimationFrame(act),
    now = () => performance.now(),
    rank = unranked,
    mayChange = () => true,
    ...handlers
  }) {
    this.pads = pads;
    this.rank = (pad) => rank(described(pad));
    this.mayChange = mayChange;
    this.frame = frame;
    this.now = now;
    this.handlers = handlers;
    /** @type {{index: number, id: string, mapping: string, axes: number, buttons: number} | null} */
    this.chosen = null;
    this.byHand = false; // whether a person chose it
    this.waiting = false;
  }

  listen(target) {
    for (const name of ["gamepadconnected", "gamepaddisconnected"]) {
      target.addEventListener(name, () => this.recount());
    }
    this.recount();
  }

  // Another device; what the last one held is lost.
  choose(index) {
    this.lose();
    const pad = this.connected().find((device) => device.index === index);
    if (pad) this.find(pad);
    this.byHand = Boolean(pad);
    this.recount();
  }

  // One that is in a hand, as its enable button was pressed.
  takeUp(index) {
    const all = this.connected();
    const pad = all.find((device) => device.index === index);
    if (pad && this.mayPass(all) && this.rank(pad) >= this.rank(this.ofChosen(all))) this.change(pad);
  }

  recount() {
    const all = this.connected();
    const better = this.better(all);
    if (better) return this.change(better);
    this.handlers.onAll(all.map((pad) => ({ index: pad.index, ...described(pad), chosen: pad.index === this.chosen?.index })));
    if (all.length > 0) this.wait();
    else this.lose(); // also while no frame is drawn
  }

  // The one that takes over from the chosen one, if any. The order in which devices came says nothing of which is in a hand.
  better(all) {
    if (!this.mayPass(all)) return null;
    const best = this.best(all);
    return this.rank(best) > this.rank(this.ofChosen(all)) ? best : null;
  }

  // Whether another one may take over.
  mayPass(all) {
    return this.ofChosen(all) && !this.byHand && this.mayChange();
  }

  best(all) {
    return all.reduce((best, pad) => (this.rank(pad) > this.rank(best) ? pad : best));
  }

  ofChosen(all) {
    return all.find((pad) => isSame({ index: pad.index, ...described(pad) }, this.chosen));
  }

  wait() {
    if (this.waiting) return;
    this.waiting = true;
    this.frame(() => this.poll());
  }

  poll() {
    this.waiting = false;
    const at = this.now();
    const all = this.connected();
    const pad = this.ofChosen(all);
    if (pad)
      this.handlers.onSeen(sampled(pad), at); // first: of two that a driver shows for one, the second must not take over
    else this.change(all.length ? this.best(all) : null);
    for (const other of all) if (other !== pad) this.handlers.onOther(other.index, sampled(other), at);
    if (all.length > 0) this.wait();
  }

  change(pad) {
    this.lose();
    if (pad) this.find(pad);
    this.recount();
  }

  find(pad) {
    this.chosen = { index: pad.index, ...described(pad) };
    this.handlers.onFound(described(pad));
  }

  lose() {
    if (!this.chosen) return;
    this.chosen = null;
    this.byHand = false;
    this.handlers.onLost();
  }

  connected() {
    return [...this.pads()].flatMap((pad) => (pad?.connected ? [pad] : []));
  }
}

/** @type {(device: object) => number} */
const unranked = () => 0;

const described = ({ id, mapping, axes, buttons }) => ({ id, mapping, axes: axes.length, buttons: buttons.length });

// The same device may come back with its axes in another order, in which a trigger would be a stick.
const isSame = (pad, chosen) => chosen !== null && Object.keys(pad).every((name) => pad[name] === chosen[name]);

const sampled = ({ axes, buttons }) => ({ axes: [...axes], buttons: buttons.map(({ pressed, value }) => pressed || value > PRESSED) });

// A page inside another one may not be let look.
function browserPads() {
  try {
    return navigator.getGamepads?.() ?? [];
  } catch {
    return [];
  }
}
