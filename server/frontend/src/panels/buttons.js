// The robot's buttons on the drive page. What a press does is deeds.js's.
// Nothing here changes its size while somebody drives: what is asked takes the place of the button that was pressed.

import { make, part, setText } from "../page.js";
import { buttons as texts } from "../texts/panels.js";
import { Deeds } from "./deeds.js";

export class Buttons {
  // `root` is the panel; `advertise` and `call` as of connection.js.
  constructor(root, { buttons, advertise, call }) {
    this.root = root;
    this.deeds = new Deeds({ buttons, advertise, call, onChange: (deed) => this.show(deed) });
    this.cells = new Map(this.deeds.all.map((deed, place) => [deed, this.cell(deed, place)]));
    part(root, "button-list").append(...[...this.cells.values()].map(({ item }) => item));
    root.hidden = buttons.length === 0;
    this.use({ live: false, driving: false });
  }

  use(now) {
    this.deeds.use(now);
    for (const deed of this.deeds.all) this.show(deed);
    setText(part(this.root, "button-hint"), texts.hint(this.deeds.usable));
  }

  cell(deed, place) {
    const { name } = deed.button;
    const state = make("small");
    const press = make("button", { type: "button", "data-testid": `button-${place}` }, make("span", {}, name), state);
    const yes = make("button", { type: "button", class: "main", "data-testid": `button-${place}-yes` }, texts.yes(name));
    const no = make("button", { type: "button", "data-testid": `button-${place}-no` }, texts.no);
    const question = make("span", { class: "button-sure", role: "group", "aria-label": texts.yes(name) }, yes, no);
    onPress(press, () => this.deeds.press(deed));
    onPress(yes, () => this.deeds.confirm(deed));
    onPress(no, () => this.deeds.cancel(deed));
    return { item: make("li", {}, press, question), press, question, yes, no, state };
  }

  // A button that goes while it has the focus hands it to what came in its place.
  show(deed) {
    const cell = this.cells?.get(deed);
    if (!cell) return;
    const asking = deed.state === "asking";
    const focused = [cell.press, cell.yes, cell.no].find((button) => button === document.activeElement);
    cell.press.hidden = asking;
    cell.question.hidden = !asking;
    cell.yes.disabled = !deed.open;
    cell.press.dataset.state = deed.state;
    // Not `disabled`: a button that is switched off while it has the focus would drop it.
    cell.press.setAttribute("aria-disabled", String(!this.deeds.usable || deed.state === "pending"));
    setText(cell.state, texts[deed.state]);
    // Without a scroll, which would move the stick.
    if (focused?.closest("[hidden]")) (asking ? cell.no : cell.press).focus({ preventScroll: true });
    this.tell(deed);
  }

  tell(deed) {
    const told = `${deed.round} ${deed.words}`;
    if (!deed.words || told === deed.told) return;
    deed.told = told;
    setText(part(this.root, "button-outcome"), deed.words);
  }
}

// A finger beside the one that holds the stick makes no click.
function onPress(button, act) {
  button.addEventListener("click", act);
  button.addEventListener("pointerup", ({ isPrimary, pointerType }) => !isPrimary && pointerType === "touch" && act());
}
