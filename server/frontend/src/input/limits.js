// How fast the inputs may ask for: the two sliders, and the higher limits of a gamepad's turbo button.

import { part } from "../pages/page.js";
import { limits as texts } from "../texts/common.js";

const STEPS = 20;

// In m/s and rad/s, as of mixing.js. `most` is the robot's own, beyond which nothing goes.
export class Limits {
  constructor({ maxLinear, maxAngular }) {
    this.most = { linear: maxLinear, angular: maxAngular };
    Object.assign(this, this.most);
    this.share = 1; // of the robot's own, with turbo
  }

  // Never slower than without.
  get turbo() {
    const { most, share } = this;
    return {
      linear: Math.max(this.linear, most.linear * share),
      angular: Math.max(this.angular, most.angular * share),
    };
  }
}

// The sliders go up to the robot's own limits and start there.
export function setUpLimits(root, { maxLinear, maxAngular }) {
  const limits = new Limits({ maxLinear, maxAngular });
  setUpSlider(root, "linear", maxLinear, (value) => (limits.linear = value));
  setUpSlider(root, "angular", maxAngular, (value) => (limits.angular = value));
  return limits;
}

function setUpSlider(root, name, max, onValue) {
  const slider = part(root, `limit-${name}`);
  const output = part(root, `limit-${name}-value`);
  Object.assign(slider, { min: max / STEPS, max, step: max / STEPS, value: max });
  const apply = () => {
    onValue(Math.min(max, Number(slider.value)));
    output.textContent = texts[name](Number(slider.value).toFixed(2));
  };
  slider.addEventListener("input", apply);
  apply();
}
