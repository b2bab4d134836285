// The keys of the picture: C the next camera, 1 to 4 one of them, F fullscreen. By their place on the keyboard, as the keys
// that drive, which they must never be.

import { TEXT, matches } from "../pages/page.js";

// Gives the deed that a key asks for: {next}, {nth: 0..3}, {fullscreen}, or null.
export function viewActionOf(event) {
  if (isMeantForOthers(event)) return null;
  const { code } = event;
  if (code === "KeyC") return { next: true };
  if (code === "KeyF") return { fullscreen: true };
  const digit = /^(?:Digit|Numpad)([1-4])$/.exec(code);
  return digit && { nth: Number(digit[1]) - 1 };
}

const isMeantForOthers = ({ repeat, ctrlKey, altKey, metaKey, target }) =>
  repeat || ctrlKey || altKey || metaKey || matches(target, TEXT);
