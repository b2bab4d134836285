// The robot's buttons on the drive page. What a press does is robotButtons.js's.
// Nothing here changes its size while somebody drives: what is asked takes the place of the button that was pressed.

import { make, part, setText } from "../pages/page.js";
import { buttons as texts } from "../texts/panels.js";
import { RobotButtons } from "./robotButtons.js";

export class Buttons {
  // `root` is the panel; `advertise` and `call` as of connection.js.
  constructor(root, { buttons, advertise, call }) {
    this.root = root;
    this.robotButtons = new RobotButtons({ buttons, advertise, call, onChange: (action) => this.show(action) });
    this.cells = new Map(this.robotButtons.all.map((action, place) => [action, this.cell(action, place)]));
    part(root, "button-list").append(...[...this.cells.values()].map(({ item }) => item));
    root.hidden = buttons.length === 0;
    this.use({ live: false, driving: false });
  }

  use(now) {
    this.robotButtons.use(now);
    for (const action of this.robotButtons.all) this.show(action);
    setText(part(this.root, "button-hint"), texts.hint(this.robotButtons.usable));
  }

  cell(action, place) {
    const { name } = action.button;
    const state = make("small");
    const press = make("button", { type: "button", "data-testid": `button-${place}` }, make("span", {}, name), state);
    const yes = make("button", { type: "button", class: "main", "data-testid": `button-${place}-yes` }, texts.yes(name));
    const no = make("button", { type: "button", "data-testid": `button-${place}-no` }, texts.no);
    const question = make("span", { class: "button-sure", role: "group", "aria-label": texts.yes(name) }, yes, no);
    onPress(press, () => this.robotButtons.press(action));
    onPress(yes, () => this.robotButtons.confirm(action));
    onPress(no, () => this.robotButtons.cancel(action));
    return { item: make("li", {}, press, question), press, question, yes, no, state };
  }

  // A button that goes while it has the focus hands it to what came in its place.
  show(action) {
    const cell = this.cells?.get(action);
    if (!cell) return;
    const asking = action.state === "asking";
    const focused = [cell.press, cell.yes, cell.no].find((button) => button === document.activeElement);
    cell.press.hidden = asking;
    cell.question.hidden = !asking;
    cell.yes.disabled = !action.open;
    cell.press.dataset.state = action.state;
    // Not `disabled`: a button that is switched off while it has the focus would drop it.
    cell.press.setAttribute("aria-disabled", String(!this.robotButtons.usable || action.state === "pending"));
    setText(cell.state, texts[action.state]);
    // Without a scroll, which would move the stick.
    if (focused?.closest("[hidden]")) (asking ? cell.no : cell.press).focus({ preventScroll: true });
    this.report(action);
  }

  report(action) {
    const reported = `${action.round} ${action.words}`;
    if (!action.words || reported === action.reported) return;
    action.reported = reported;
    setText(part(this.root, "button-outcome"), action.words);
  }
}

// A finger beside the one that holds the stick makes no click.
function onPress(button, act) {
  button.addEventListener("click", act);
  button.addEventListener("pointerup", ({ isPrimary, pointerType }) => !isPrimary && pointerType === "touch" && act());
}
