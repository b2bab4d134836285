// Publishes drive commands on the robot's drive topic, each with its moment. Pure.
// It must advertise nothing on a connection that only watches: the server would refuse it.

import { driveMessage } from "./messages.js";

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
