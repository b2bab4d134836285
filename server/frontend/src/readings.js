// The numbers of the drive page: measured speed, commanded speed, round trip.

import { byTestId, part, setText } from "./page.js";
import { readings as texts } from "./texts.js";

const OLD_MS = 2500;

export class Readings {
  constructor(root) {
    this.root = root;
  }

  speed(measured) {
    this.value("speed-linear", measured ? decimals(measured.forward) : texts.none);
    this.value("speed-angular", measured ? decimals(measured.turn) : texts.none);
  }

  wanted({ forward, turn }) {
    this.write("wanted-linear", texts.wanted(decimals(forward)));
    this.write("wanted-angular", texts.wanted(decimals(turn)));
  }

  rtt(reading) {
    const old = reading && reading.ageMs > OLD_MS;
    this.value("rtt", reading ? String(Math.round(reading.medianMs)) : texts.none);
    setText(part(this.root, "rtt-age"), old ? texts.old(Math.round(reading.ageMs / 1000)) : "");
  }

  // The unit beside the value stands in the template.
  value(testId, text) {
    setText(part(byTestId(this.root, testId), "value"), text);
  }

  write(testId, text) {
    setText(byTestId(this.root, testId), text);
  }
}

// Two decimals, and no "-0.00" for a robot that stands still.
export const decimals = (value) => (Math.abs(value) < 0.005 ? 0 : value).toFixed(2);
