// Shows the speed that the robot reports, and says nothing rather than something old.

import { speedReader } from "../client/messages.js";
import { poseReader } from "./poses.js";

const THROTTLE_MS = 100;
const OLD_MS = 1000;

export class Readback {
  // `subscribe(spec, handler)` as of connection.js; `onSpeed` gets {forward, turn} or null for unknown,
  // `onPose` {x, y, theta} in the odometry's frame, with each message.
  constructor({ subscribe, onSpeed, onPose = () => {} }) {
    Object.assign(this, { subscribe, onSpeed, onPose });
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
    const [read, readPose] = [speedReader(type), poseReader(type)];
    this.end = this.subscribe({ name, type, throttleMs: THROTTLE_MS }, (message) => {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.forget(), OLD_MS);
      this.onSpeed(read(message));
      if (readPose) this.onPose(readPose(message));
    });
  }

  forget() {
    clearTimeout(this.timer);
    this.onSpeed(null);
  }
}
