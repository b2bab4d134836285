// All that drives a robot over one connection that stays: the connection itself, the relay's clock, news of the control,
// and drive commands, each with its moment. Used by the drive page and by index.js.
// It must never believe what a robot says in the relay's name.

import { Beats } from "../beats.js";
import { Commands } from "../commands.js";
import { Connection } from "../connection.js";
import { openLink } from "../link.js";
import { ControlNews } from "../news.js";

const BACKLOG_BYTES = 2048; // about half a second of drive commands
const SILENCE_MS = 2000; // the robot answers each second; what is sent into silence arrives late

export class Session {
  // `requestUrl()`, `prepare`, `onState` and `onLeaving` as of connection.js; `onControl(control)` with what is known of
  // who drives and whether the robot is stopped.
  constructor({ driveTopic, wheelbase, requestUrl, prepare, onState, onLeaving, onControl }) {
    this.beats = new Beats();
    this.news = new ControlNews({ onControl });
    this.connection = new Connection({
      requestTicket: requestUrl,
      openLink,
      prepare,
      onState,
      onLeaving,
      onLink: (tell) => (tell ? this.beats.start(tell) : this.forgetLink()),
      onOwn: (operation) => this.hear(operation),
    });
    this.commands = new Commands({
      topic: driveTopic,
      wheelbase,
      advertise: (spec) => this.connection.advertise(spec),
      stamp: (moment) => this.beats.stamp(moment),
    });
  }

  hear(operation) {
    if (!this.beats.isRelays(operation)) return;
    if (operation.op === "robotether.beat") this.beats.hear(operation);
    if (operation.op === "robotether.control") this.news.fromLink(operation.control);
  }

  forgetLink() {
    this.beats.stop();
    this.news.linkEnded();
  }

  // Whether a command that is sent now would be at the robot soon, and not wait behind old ones.
  get mayQueue() {
    const { backlog, silenceMs } = this.connection;
    return backlog < BACKLOG_BYTES && silenceMs < SILENCE_MS;
  }

  // Says whether it went; the caller asks the API as well.
  stop() {
    return this.connection.tell({ op: "robotether.stop" });
  }
}
