// The way roslib's Ros sends and receives: JSON text over a WebSocket, without the decoders for
// compressed messages that roslib brings (the pages never ask for compression).
// Operations of our own (docs/protocols.md) go to `own` handlers alone: roslib does not know them.

const OWN = "robotether.";

export class JsonTransport {
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
