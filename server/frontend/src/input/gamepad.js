// A gamepad as an input of teleop.js. It drives only while its enable button is held, and only by a press that was
// seen while it counted: one that is stuck, or was held through a drop, a loss or a late look, moves nothing until it
// is released and pressed anew. Its stop button stops whether it may drive or not. Pure.

import { asked } from "./gamepadProfile.js";

// For as long is a look good: between two that are further apart a release may have been missed.
export const MAX_POLL_GAP_MS = 250;

export class Gamepad {
  // `accepts()` says whether driving counts now. `onHold` gets the input and the moment of the look; `onStop()` comes
  // with each press of the stop button; `onState` tells "unknown" (no profile), "off" (nothing counts now),
  // "stuck" (enable must be released first), "ready", "driving" or "turbo".
  constructor({ accepts, onHold, onRelease, onStop, onState = () => {} }) {
    Object.assign(this, { accepts, onHold, onRelease, onStop, onState });
    this.profile = null;
    this.forget();
  }

  // As of gamepadProfile.js; null for a device that nobody knows.
  use(profile) {
    this.release();
    this.profile = profile;
  }

  // `sample` is {axes, buttons} at this moment, by the clock of event.timeStamp: positions, and true for what is pressed.
  see(sample, at) {
    if (at - this.seenAt > MAX_POLL_GAP_MS) this.release();
    this.seenAt = at;
    if (!this.profile) return this.onState("unknown");
    this.watchStop(sample.buttons);
    this.watchEnable(sample, at);
    this.onState(this.state(sample.buttons));
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
    if (held) this.onRelease();
  }

  watchStop(buttons) {
    const down = this.profile.stop !== null && buttons[this.profile.stop];
    const pressed = down && !this.stopDown;
    this.stopDown = down;
    if (pressed) this.onStop();
  }

  watchEnable(sample, at) {
    const down = sample.buttons[this.profile.enable];
    if (!down || !this.ready || !this.accepts()) {
      this.release();
      this.ready = !down;
      return;
    }
    this.held = true;
    const input = asked(this.profile, sample);
    this.turbo = input.turbo;
    this.onHold(input, at);
  }

  state(buttons) {
    if (this.held) return this.turbo ? "turbo" : "driving";
    if (!this.accepts()) return "off";
    return buttons[this.profile.enable] ? "stuck" : "ready";
  }
}
