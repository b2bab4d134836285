// Shows the speed that the robot reports, and says nothing rather than something old.

import { speedReader } from "./messages.js";

const THROTTLE_MS = 100;
const OLD_MS = 1000;

export class Readback {
  // `subscribe(spec, handler)` as of connection.js; `onSpeed` gets {forward, turn} or null for unknown.
  constructor({ subscribe, onSpeed }) {
    Object.assign(this, { subscribe, onSpeed });
    this.topic = null;
  }

  // `topic` is {name, type}. Following the same one again changes nothing.
  follow(topic) {
    if (topic.name === this.topic?.name && topic.type === this.topic?.type) return;
    this.end?.();
    this.topic = topic;
    this.forget();
    this.listen(topic);
  }

  listen({ name, type }) {
    const read = speedReader(type);
    this.end = this.subscribe({ name, type, throttleMs: THROTTLE_MS }, (message) => {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.forget(), OLD_MS);
      this.onSpeed(read(message));
    });
  }

  forget() {
    clearTimeout(this.timer);
    this.onSpeed(null);
  }
}
