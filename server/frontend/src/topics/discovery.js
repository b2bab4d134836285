// Asks the robot which topics it has, through rosapi, and asks again until it has told what the page needs.

import { speedReader, speedTopic, twistType } from "../client/messages.js";
import { cameraTopics, topicOf } from "../video/sources.js";

const AGAIN_MS = 5000;

export class Discovery {
  // `onFound` gets {twistType, speed, cameras, topics}, all topics as {name, type}. `odometryTopic` is the setting's, or null.
  constructor({ driveTopic, odometryTopic = null, onFound }) {
    Object.assign(this, { driveTopic, odometryTopic, onFound });
    this.round = 0;
    this.knownType = "";
  }

  // `call(service, request)` as of connection.js. Resolves when the robot has answered.
  async run(call) {
    this.stop();
    this.call = call;
    const round = this.round;
    const [topics, driveType] = await Promise.all([allTopics(call), this.driveType(call)]);
    if (round !== this.round) return;
    const found = {
      twistType: twistType(
        driveType,
        topics.map(({ type }) => type),
      ),
      speed: this.speed(topics),
      cameras: cameraTopics(topics),
      topics,
    };
    this.onFound(found);
    if (!found.speed || found.cameras.length === 0) {
      this.timer = setTimeout(() => this.run(call), AGAIN_MS);
    }
  }

  // For somebody who wants to know now; without effect while there is no link.
  refresh() {
    if (this.call) this.run(this.call);
  }

  stop() {
    this.call = null;
    clearTimeout(this.timer);
    this.round += 1;
  }

  speed(topics) {
    if (!this.odometryTopic) return speedTopic(topics);
    const named = topicOf("odometry", topics, this.odometryTopic);
    return speedReader(named.type) ? named : undefined;
  }

  // What the robot told once stands while it does not tell: another type in mid-drive would stop it.
  async driveType(call) {
    const { type } = await ask(call, "/rosapi/topic_type", { topic: this.driveTopic });
    this.knownType = type || this.knownType;
    return this.knownType;
  }
}

async function allTopics(call) {
  const { topics = [], types = [] } = await ask(call, "/rosapi/topics", {});
  return topics.map((name, i) => ({ name, type: types[i] || "" }));
}

// A robot without rosapi is no error: the page then goes by the usual names.
async function ask(call, service, request) {
  const { ok, values } = await call(service, request);
  return (ok && values) || {};
}
