// All that drives a robot over one connection that stays: the connection itself, the relay's clock, news of the control,
// and drive commands, each with its moment. Used by the drive page and by index.js.
// It must never believe what a robot says in the relay's name.

import { ClockSync } from "./clockSync.js";
import { Connection } from "./connection.js";
import { openLink } from "./link.js";
import { driveMessage } from "./messages.js";

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

// Publishes drive commands on the robot's drive topic, each with its moment. Pure.
// It must advertise nothing on a connection that only watches: the server would refuse it.
export class Commands {
  // `advertise(spec)` as of connection.js; `stamp(timestamp)` as of clockSync.js; `wheelbase` in m of a robot that steers.
  constructor({ topic, advertise, stamp, wheelbase = null }) {
    Object.assign(this, { topic, advertise, stamp, wheelbase });
    this.type = null;
    this.publisher = null;
    this.used = false;
  }

  // The type that the robot takes, as soon as it has told.
  useType(type) {
    if (type === this.type) return;
    this.type = type;
    this.renew();
  }

  // Whether the page has a connection that drives.
  use(used) {
    this.used = used;
    this.renew();
  }

  renew() {
    this.publisher?.end();
    const wanted = this.used && this.type;
    this.publisher = wanted ? this.advertise({ name: this.topic, type: this.type }) : null;
  }

  publish(twist, timestamp) {
    const { type, wheelbase } = this;
    this.publisher?.publish(driveMessage(type, twist, { wheelbase }), this.stamp(timestamp));
  }
}

// What is known of a robot's control object (docs/reference/protocols.md, "Control"). It comes twice: on the page's own
// connection and with the fleet's events. Mixing them would bring old news after new ones, so while the
// connection tells it, it alone counts. Pure.
export class ControlState {
  constructor({ onControl }) {
    this.onControl = onControl;
    this.linked = false;
    this.pending = null;
  }

  fromLink(control) {
    this.linked = true;
    this.pending = null;
    this.onControl(control);
  }

  fromFeed(control) {
    if (this.linked) this.pending = control;
    else this.onControl(control);
  }

  // What the events told since the connection's last word counts when that one has ended.
  linkEnded() {
    const { pending } = this;
    this.linked = false;
    this.pending = null;
    if (pending) this.onControl(pending);
  }
}
