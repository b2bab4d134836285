// The Stop button of one robot on the fleet page, and what is known of that robot's stop. A robot has one, in the card or
// in the row of the table, whichever is shown.

import { stop } from "../pages/calls.js";
import { localTime, part, setText } from "../pages/page.js";
import { Stopping } from "../control/stopping.js";
import { stop as texts } from "../texts/common.js";

export class CardStop {
  constructor(robot) {
    this.robot = robot;
    this.cards = new Set();
    this.state = "";
    this.stopping = new Stopping({
      send: () => {}, // this page has no connection to the robot
      post: () => stop(robot),
      onChange: () => this.show(),
    });
  }

  join(card) {
    this.cards.add(card);
    const button = part(card, "stop");
    setText(part(button, "stop-name"), ` ${this.robot}`);
    button.addEventListener("click", () => this.stopping.press());
    this.show();
  }

  // `robot` as of the events. One that waits for approval, or is disabled, has no connection to stop.
  receive({ state, control }) {
    this.state = state;
    this.stopping.receive(control?.stopped);
  }

  show() {
    const { kind, by, at, detail } = this.stopping.shown;
    const words = texts[kind]({ by, at: localTime(at), detail });
    for (const card of this.cards) {
      const button = part(card, "stop");
      if (button.hidden !== (this.state !== "active")) button.hidden = this.state !== "active";
      if (card.dataset.stop !== kind) card.dataset.stop = kind;
      setText(part(card, "stopped"), words);
      const row = part(card, "stopped-row");
      if (row.hidden !== (kind === "none")) row.hidden = kind === "none";
    }
  }
}
