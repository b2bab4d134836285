// One roslib connection, from its opening to its end; connection.js opens the next one.
// A fresh Ros a link: roslib would otherwise queue what is sent while it is cut, and replay old
// drive commands to the robot when the link returns.

import { Ros, Service, Topic } from "roslib";
import { JsonTransport } from "./transport.js";

export function openLink(url, { onOpen, onMessage, onClose }) {
  return new Link(url, { onOpen, onMessage, onClose });
}

class Link {
  constructor(url, { onOpen, onMessage, onClose }) {
    this.transport = new JsonTransport(url);
    this.transport.on("message", onMessage);
    this.ros = new Ros({ transportFactory: async () => this.transport });
    this.ros.on("connection", onOpen);
    this.ros.on("close", onClose);
    this.ros.on("error", () => {}); // a close with the reason follows each error
    this.ros.connect(url);
  }

  topic({ name, type, throttleMs = 0 }) {
    return new Topic({
      ros: this.ros,
      name,
      messageType: type,
      throttle_rate: throttleMs,
      queue_length: throttleMs ? 1 : 0,
      queue_size: 1,
      reconnect_on_close: false,
    });
  }

  subscribe(spec, handler) {
    const topic = this.topic(spec);
    topic.subscribe(handler);
    return { end: () => topic.unsubscribe() };
  }

  advertise(spec) {
    const topic = this.topic(spec);
    topic.advertise();
    return {
      publish: (message) => topic.publish(message),
      end: () => topic.unadvertise(),
    };
  }

  // Settles with {ok, values} for any answer, also for one that says that the call failed.
  call(name, request) {
    const service = new Service({ ros: this.ros, name, serviceType: "" });
    return new Promise((resolve) => {
      service.callService(
        request,
        (values) => resolve({ ok: true, values }),
        (values) => resolve({ ok: false, values }),
      );
    });
  }

  get backlog() {
    return this.transport.backlog;
  }

  close() {
    this.transport.close();
  }
}
