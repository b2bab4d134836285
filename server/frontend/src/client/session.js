// All that drives a robot over one connection that stays: the connection itself, the relay's clock, news of the control,
// and drive commands, each with its moment. Used by the drive page and by index.js.
// It must never believe what a robot says in the relay's name.

import { ClockSync } from "./clockSync.js";
import { Commands } from "./commands.js";
import { Connection } from "./connection.js";
import { openLink } from "./link.js";
import { ControlState } from "./controlState.js";

const BACKLOG_BYTES = 2048; // about half a second of drive commands
const SILENCE_MS = 2000; // the robot answers each second; what is sent into silence arrives late

export class Session {
  // `requestUrl()`, `prepare`, `onState` and `onLeaving` as of connection.js; `onControl(control)` with what is known of
  // who drives and whether the robot is stopped.
  constructor({ driveTopic, wheelbase, requestUrl, prepare, onState, onLeaving, onControl }) {
    this.clockSync = new ClockSync();
    this.controlState = new ControlState({ onControl });
    this.connection = new Connection({
      requestTicket: requestUrl,
      openLink,
      prepare,
      onState,
      onLeaving,
      onLink: (send) => (send ? this.clockSync.start(send) : this.forgetLink()),
      onOwn: (operation) => this.receive(operation),
    });
    this.commands = new Commands({
      topic: driveTopic,
      wheelbase,
      advertise: (spec) => this.connection.advertise(spec),
      stamp: (timestamp) => this.clockSync.stamp(timestamp),
    });
  }

  receive(operation) {
    if (!this.clockSync.isRelays(operation)) return;
    if (operation.op === "robotether.beat") this.clockSync.receive(operation);
    if (operation.op === "robotether.control") this.controlState.fromLink(operation.control);
  }

  forgetLink() {
    this.clockSync.stop();
    this.controlState.linkEnded();
  }

  // Whether a command that is sent now would be at the robot soon, and not wait behind old ones.
  get mayQueue() {
    const { backlog, silenceMs } = this.connection;
    return backlog < BACKLOG_BYTES && silenceMs < SILENCE_MS;
  }

  // Says whether it went; the caller asks the API as well.
  stop() {
    return this.connection.send({ op: "robotether.stop" });
  }
}
