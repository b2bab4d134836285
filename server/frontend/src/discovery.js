// Asks the robot which topics it has, through rosapi, and asks again until it has told what the page needs.

import { imageTopics, speedTopic, twistType } from "./messages.js";

const AGAIN_MS = 5000;

export class Discovery {
  // `onFound` gets {twistType, speed, cameras}.
  constructor({ driveTopic, onFound }) {
    Object.assign(this, { driveTopic, onFound });
    this.round = 0;
  }

  // `call(service, request)` as of connection.js. Resolves when the robot has answered.
  async run(call) {
    this.stop();
    const round = this.round;
    const [topics, driveType] = await Promise.all([allTopics(call), this.driveType(call)]);
    if (round !== this.round) return;
    const found = {
      twistType: twistType(driveType, topics.map(({ type }) => type)),
      speed: speedTopic(topics),
      cameras: imageTopics(topics),
    };
    this.onFound(found);
    if (!found.speed || found.cameras.length === 0) {
      this.timer = setTimeout(() => this.run(call), AGAIN_MS);
    }
  }

  stop() {
    clearTimeout(this.timer);
    this.round += 1;
  }

  async driveType(call) {
    return (await ask(call, "/rosapi/topic_type", { topic: this.driveTopic })).type || "";
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
