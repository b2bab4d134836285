// The space bar stops the robot wherever it is pressed on the drive page, except in a text that is being typed
// and on a button that is there to be held. It neither scrolls nor presses what has the focus; a checkbox, which no
// other key would check, takes Enter instead.

import { TEXT, matches } from "../pages/page.js";

const HELD = "[data-hold]";
const CHECKBOX = "input[type=checkbox]";

export function stopOnSpace(target, onStop) {
  target.addEventListener("keydown", (event) => meant(event) && act(event, onStop), { capture: true });
  // Firefox presses a button on the keyup.
  target.addEventListener("keyup", (event) => meant(event) && event.preventDefault(), { capture: true });
  target.addEventListener("keydown", check);
}

function check(event) {
  const { code, repeat, target } = event;
  if (repeat || !["Enter", "NumpadEnter"].includes(code) || !matches(target, CHECKBOX)) return;
  event.preventDefault();
  target.click();
}

function act(event, onStop) {
  event.preventDefault();
  event.stopPropagation();
  if (!event.repeat) onStop();
}

function meant({ code, target, ctrlKey, altKey, metaKey, isComposing }) {
  if (code !== "Space" || ctrlKey || altKey || metaKey || isComposing) return false;
  return !matches(target, TEXT) && !matches(target, HELD);
}
