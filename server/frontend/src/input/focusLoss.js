// Lets go of all that is held at every sign that nobody may be looking at the page, or that the browser
// may keep the release of a key or pointer for itself. Set up by controls.js.
// What is let go must be pressed anew: none of these may ever start anything.

import { TYPING, matches } from "../pages/page.js";

const ALWAYS = ["blur", "pagehide", "beforeprint", "fullscreenchange", "webkitfullscreenchange"];

export function releaseOnFocusLoss(letGo, { window, document } = globalThis) {
  const on = (target, names, applies = () => true) => {
    for (const name of names) target.addEventListener(name, (event) => applies(event) && letGo());
  };
  on(window, ALWAYS);
  on(document, ["visibilitychange", "freeze", "resume"]);
  on(window, ["pointerdown", "pointermove"], opensMenu);
  on(window, ["contextmenu"], (event) => !event.defaultPrevented);
  on(window, ["focusin"], ({ target }) => matches(target, TYPING));
  on(window, ["dragstart"], refuse);
}

// Menus of the browser and lists of a <select> keep the keys until they close. A button that is pressed
// while another one is down comes as a pointermove.
const opensMenu = ({ button, target, type }) => button > 0 || (type === "pointerdown" && matches(target, "select"));

function refuse(event) {
  event.preventDefault();
  return true;
}
