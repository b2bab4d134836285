// One roslib connection, from its opening to its end; connection.js opens the next one.
// A fresh Ros a link: roslib would otherwise queue what is sent while it is cut, and replay old
// drive commands to the robot when the link returns.

import { Ros, Topic } from "roslib";

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

  topic({ name, type, throttleMs = 0, queueLength = throttleMs ? 1 : 0 }) {
    return new Topic({
      ros: this.ros,
      name,
      messageType: type,
      throttle_rate: throttleMs,
      queue_length: queueLength,
      queue_size: 1,
      reconnect_on_close: false,
    });
  }

  // `onRefused(why)` of the spec hears when the server does not let the subscription through.
  subscribe(spec, handler) {
    const topic = this.topic(spec);
    topic.subscribe(handler);
    const status = `status:${topic.subscribeId}`;
    if (spec.onRefused) this.ros.on(status, ({ level, msg }) => level === "error" && spec.onRefused(msg));
    return {
      end: () => {
        topic.unsubscribe();
        this.ros.off(status);
      },
    };
  }

  // What is published may carry `robotether`, the moment of a drive command, which roslib has no place for.
  // `onRefused(why)` of the spec hears of each message that the server did not let through.
  advertise(spec) {
    const topic = this.topic(spec);
    topic.advertise();
    const id = spec.onRefused && this.newId(`publish:${spec.name}`);
    if (id) this.ros.on(`status:${id}`, ({ level, msg }) => level === "error" && spec.onRefused(msg));
    return {
      publish: (msg, robotether) => this.transport.send({ op: "publish", id, topic: spec.name, msg, robotether }),
      end: () => {
        topic.unadvertise();
        if (id) this.ros.off(`status:${id}`);
      },
    };
  }

  // Settles with {ok, values} for any answer, also for one that says that the call failed, and for the server's
  // refusal, which is no answer of the robot's: roslib would wait for that for ever.
  call(service, args, type) {
    const id = this.newId(`call_service:${service}`);
    return new Promise((resolve) => {
      const settle = (answer) => {
        this.ros.off(id);
        this.ros.off(`status:${id}`);
        resolve(answer);
      };
      this.ros.on(id, ({ result, values }) => settle({ ok: Boolean(result), values }));
      this.ros.on(`status:${id}`, ({ level, msg }) => level === "error" && settle({ ok: false, values: msg }));
      this.transport.send({ op: "call_service", id, service, type, args });
    });
  }

  newId(beginning) {
    this.ids = (this.ids ?? 0) + 1;
    return `${beginning}:${this.ids}`;
  }

  // Sends an operation of our own now or not at all, and says which.
  send(operation) {
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

// The way roslib's Ros sends and receives: JSON text over a WebSocket, without the decoders for
// compressed messages that roslib brings (the pages never ask for compression).
// Operations of our own (docs/reference/protocols.md) go to `own` handlers alone: roslib does not know them.
const OWN = "robotether.";

class JsonTransport {
  constructor(url) {
    this.handlers = { open: [], close: [], error: [], message: [], own: [] };
    this.socket = new WebSocket(url);
    this.socket.onopen = (event) => this.emit("open", event);
    this.socket.onclose = (event) => this.emit("close", event);
    this.socket.onerror = (event) => this.emit("error", event);
    this.socket.onmessage = ({ data }) => this.receive(data);
  }

  on(event, handler) {
    this.handlers[event].push(handler);
    return this;
  }

  emit(event, value) {
    for (const handler of this.handlers[event]) handler(value);
  }

  receive(data) {
    if (typeof data !== "string") return;
    let message;
    try {
      message = JSON.parse(data);
    } catch {
      return; // one broken message from a robot must not end the session
    }
    if (message && typeof message.op === "string") this.emit(kind(message), message);
  }

  send(message) {
    this.socket.send(JSON.stringify(message));
  }

  close() {
    this.socket.close();
  }

  // Bytes that the browser has taken and the network has not.
  get backlog() {
    return this.socket.bufferedAmount;
  }

  isConnecting() {
    return this.socket.readyState === WebSocket.CONNECTING;
  }

  isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  isClosing() {
    return this.socket.readyState === WebSocket.CLOSING;
  }

  isClosed() {
    return this.socket.readyState === WebSocket.CLOSED;
  }
}

const kind = ({ op }) => (op.startsWith(OWN) ? "own" : "message");
