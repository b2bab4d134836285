// The banner that says how the connection stands and offers what a person can do about it.

import { byTestId, part, setText } from "./page.js";
import { connection as texts, logIn } from "./texts.js";

export class Banner {
  constructor(root, { onRetry }) {
    this.element = byTestId(root, "state");
    this.button = part(this.element, "state-action");
    this.button.addEventListener("click", () => this.act());
    this.onRetry = onRetry;
  }

  // `state` as of states.js; `facts` are {driving, armed, since} for the sentence.
  show(state, facts) {
    const text = texts[state.name];
    this.state = state;
    this.element.dataset.state = state.name;
    setText(part(this.element, "state-title"), text.title);
    setText(part(this.element, "state-detail"), text.detail({ ...facts, reason: state.reason }));
    const action = state.login ? logIn : text.action;
    this.button.hidden = !action;
    setText(this.button, action ?? "");
  }

  act() {
    if (this.state.login) location.assign(`/login?next=${encodeURIComponent(location.pathname)}`);
    else if (this.state.name === "not_allowed") location.reload();
    else this.onRetry();
  }
}
