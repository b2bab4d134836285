// The banner that shows the state and offers what a person can do about it.

import { byTestId, part, setText } from "../pages/page.js";
import { connection, logIn, states } from "../texts/common.js";
import { Deafness } from "./question.js";

/** @typedef {import("./driveMode.js").Control} Control */

const texts = { ...connection, ...states };

export class Banner {
  // `onRetry()`: try to connect now; `onBlind()`: a person wants to drive without video.
  constructor(root, { onRetry, onBlind, now = () => performance.now() }) {
    this.element = byTestId(root, "state");
    this.button = part(this.element, "state-action");
    this.button.addEventListener("click", () => this.act());
    this.onRetry = onRetry;
    this.onBlind = onBlind;
    this.offered = undefined;
    this.deafness = new Deafness(now); // who presses sooner meant what the button was before
  }

  // `state` as of connection.js; `facts` are those of `selectStatus` and what the sentences need.
  show(state, facts) {
    this.state = state;
    this.shown = selectStatus(state, facts);
    const text = texts[this.shown];
    this.element.dataset.state = state.name;
    this.element.dataset.shown = this.shown;
    setText(part(this.element, "state-title"), text.title);
    setText(part(this.element, "state-detail"), text.detail({ ...facts, reason: state.reason }));
    this.offer(state.login ? logIn : text.action);
  }

  // A button that goes while it has the focus leaves it to the banner, or the next Tab would begin at the top.
  offer(action) {
    if (this.offered && action !== this.offered) this.deafness.renew();
    this.offered = action;
    const focused = this.button === document.activeElement;
    this.button.hidden = !action;
    setText(this.button, action ?? "");
    if (focused && !action) this.element.focus();
  }

  act() {
    if (this.state.login) location.assign(`/login?next=${encodeURIComponent(location.pathname)}`);
    else if (this.shown === "not_allowed") location.reload();
    else if (this.shown === "held") this.goBlind();
    else this.onRetry();
  }

  goBlind() {
    if (!this.deafness.active) this.onBlind();
  }
}

// The one state that the page's banner shows, out of all that is true at once: what keeps the robot from driving
// comes first. Pure.
const AWAY = ["offline", "link_lost"]; // what a robot is that was disabled

// `state` is the connection's (connection.js); `control` as in docs/reference/protocols.md, `video` the kind of the VideoInterlock; `disabled` by an
// administrator.
export function selectStatus({ name }, { control, driving, video, disabled = false }) {
  if (name !== "live") return disabled ? asDisabled(name) : name;
  return robotStatus(control ?? {}) ?? (driving ? videoStatus(video) : null) ?? "live";
}

const asDisabled = (name) => (AWAY.includes(name) ? "disabled" : name);

function robotStatus(/** @type {Partial<Control>} */ { stopped, guard }) {
  if (stopped) return stopped.confirmed ? "stopped" : "stopping";
  return guard === "down" ? "guard_down" : null;
}

// Whoever watches is held by nothing.
function videoStatus(video) {
  if (video === "missing" || video === "old") return "held";
  return video === "blind" ? "blind" : null;
}
