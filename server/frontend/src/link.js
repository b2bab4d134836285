// One roslib connection, from its opening to its end; connection.js opens the next one.
// A fresh Ros a link: roslib would otherwise queue what is sent while it is cut, and replay old
// drive commands to the robot when the link returns.

import { Ros, Service, Topic } from "roslib";
import { JsonTransport } from "./transport.js";

export function openLink(url, handlers) {
  return new Link(url, handlers);
}

class Link {
  // `onMessage` gets what the robot says, `onOwn` what the relay says in operations of our own.
  constructor(url, { onOpen, onMessage, onOwn, onClose }) {
    this.transport = new JsonTransport(url);
    this.transport.on("message", onMessage);
    this.transport.on("own", onOwn);
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

  // What is published may carry `robotether`, the moment of a drive command, which roslib has no place for.
  advertise(spec) {
    const topic = this.topic(spec);
    topic.advertise();
    return {
      publish: (msg, robotether) =>
        this.transport.send({ op: "publish", topic: spec.name, msg, robotether }),
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

  // Sends an operation of our own now or not at all, and says which.
  tell(operation) {
    const open = this.transport.isOpen();
    if (open) this.transport.send(operation);
    return open;
  }

  get backlog() {
    return this.transport.backlog;
  }

  close() {
    this.transport.close();
  }
}
