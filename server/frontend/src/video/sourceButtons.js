// The buttons over the video's upper edge: one for each source, camera or map, that may be the main one.
// A button stays the same one as long as its source does, and none is moved for another: a finger or the focus may be on it.

import { KeyedRows } from "../dom/keyedRows.js";
import { make, part, setText } from "../dom/page.js";

export const NUMBER_KEYS = 4; // of the sources, as of viewActionOf in view.js

export class SourceButtons {
  // `onChoose(id)` makes a source the main one.
  constructor(group, { onChoose }) {
    this.group = group;
    this.rows = new KeyedRows({ container: group, keyOf: ({ id }) => id, make: makeButton, fill: label });
    group.addEventListener("click", ({ target }) => {
      const button = target.closest("button");
      if (button) onChoose(button.value); // else it was beside the buttons
    });
  }

  // `sources` are {id, name}, in their order.
  offer(sources) {
    this.rows.show(sources);
    this.group.hidden = sources.length < 2;
  }

  // `main` is the id of the main source. One that a key chose may be where the buttons have to be scrolled to.
  show(main) {
    for (const button of this.group.children) {
      const pressed = String(button.value === main);
      if (button.getAttribute("aria-pressed") === pressed) continue;
      button.setAttribute("aria-pressed", pressed);
      if (button.value === main) button.scrollIntoView({ block: "nearest", inline: "nearest" });
    }
  }
}

function makeButton({ id }) {
  const parts = [make("small", { "data-part": "key", "aria-hidden": "true" }), make("span", { "data-part": "name" })];
  return make("button", { type: "button", value: id, "aria-pressed": "false" }, ...parts);
}

function label(button, { name }, place) {
  const number = place + 1;
  const key = number <= NUMBER_KEYS ? String(number) : "";
  button.dataset.testid = `view-${number}`;
  button.title = name; // may be cut
  if (key) button.setAttribute("aria-keyshortcuts", key);
  else button.removeAttribute("aria-keyshortcuts");
  setText(part(button, "key"), key);
  setText(part(button, "name"), name);
}
