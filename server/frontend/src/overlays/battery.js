// What is said of a robot's battery, on the fleet page and beside the video. Pure.

import { fleet as texts } from "../texts/fleet.js";

const LOW_PERCENT = 20;
const FAIR_PERCENT = 40;

// Not of one whose level is unknown.
export const isLow = (battery) => Boolean(battery) && battery.percent !== null && !battery.charging && battery.percent < LOW_PERCENT;

export function batteryText({ online, battery }) {
  if (!online || !battery) return "";
  const text = texts.battery(battery.percent);
  if (battery.charging) return texts.charging(text);
  return isLow(battery) ? texts.low(text) : text;
}

export function chargeHealth({ online, battery }) {
  if (!online || !battery || battery.percent === null) return "";
  if (isLow(battery)) return "poor";
  return battery.percent >= FAIR_PERCENT || battery.charging ? "good" : "fair";
}
