// The Stop button of one card of the fleet page, and what is known of that robot's stop.

import { stop } from "./calls.js";
import { localTime, part, setText } from "./page.js";
import { Stopping } from "./stopping.js";
import { stop as texts } from "./texts.js";

export class CardStop {
  constructor(card, robot) {
    this.card = card;
    this.stopping = new Stopping({
      tell: () => {}, // this page has no connection to the robot
      post: () => stop(robot),
      onChange: () => this.show(),
    });
    this.button = part(card, "stop");
    setText(part(this.button, "stop-name"), ` ${robot}`);
    this.button.addEventListener("click", () => this.stopping.press());
  }

  // `robot` as of the events. One that waits for approval, or is disabled, has no connection to stop.
  hear({ state, control }) {
    this.button.hidden = state !== "active";
    this.stopping.hear(control?.stopped);
  }

  show() {
    const { kind, by, at, detail } = this.stopping.shown;
    this.card.dataset.stop = kind;
    setText(part(this.card, "stopped"), texts[kind]({ by, at: localTime(at), detail }));
    part(this.card, "stopped-row").hidden = kind === "none";
  }
}
