// Asks the robot which topics it has, through rosapi, and asks again until it has told what the page needs.

import { imageTopics, speedTopic, twistType } from "./messages.js";

const AGAIN_MS = 5000;

export class Discovery {
  // `call(service, request)` as of connection.js; `onFound` gets {twistType, speed, cameras}.
  constructor({ call, driveTopic, onFound }) {
    Object.assign(this, { call, driveTopic, onFound });
  }

  async run() {
    clearTimeout(this.timer);
    const round = (this.round = (this.round || 0) + 1);
    const topics = await this.topics();
    const driveType = await this.driveType();
    if (round !== this.round) return;
    const found = {
      twistType: twistType(driveType, topics.map(({ type }) => type)),
      speed: speedTopic(topics),
      cameras: imageTopics(topics),
    };
    this.onFound(found);
    if (!found.speed || found.cameras.length === 0) {
      this.timer = setTimeout(() => this.run(), AGAIN_MS);
    }
  }

  stop() {
    clearTimeout(this.timer);
    this.round = (this.round || 0) + 1;
  }

  async topics() {
    const { topics = [], types = [] } = await this.ask("/rosapi/topics", {});
    return topics.map((name, i) => ({ name, type: types[i] || "" }));
  }

  async driveType() {
    return (await this.ask("/rosapi/topic_type", { topic: this.driveTopic })).type || "";
  }

  // A robot without rosapi is no error: the page then goes by the usual names.
  async ask(service, request) {
    const { ok, values } = await this.call(service, request).catch(() => ({ ok: false }));
    return (ok && values) || {};
  }
}
