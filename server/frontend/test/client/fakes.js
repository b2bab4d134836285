// Test doubles of the client's tests: what a server sends, and a WebSocket that the test plays the server of.

// A binary message of the frames protocol.
export function framed({ codec = 1, flags = 0, quality = 70, sequence = 1, timestampMs = 0, data = [255] } = {}) {
  const message = new ArrayBuffer(16 + data.length);
  const view = new DataView(message);
  view.setUint8(0, codec);
  view.setUint8(1, flags);
  view.setUint16(2, quality);
  view.setUint32(4, sequence);
  view.setFloat64(8, timestampMs);
  new Uint8Array(message, 16).set(data);
  return message;
}

export class FakeWebSocket {
  /** @type {any[]} */
  static opened = []; // those of a test, which begins it anew
  static CONNECTING = 0;
  static OPEN = 1;
  static CLOSING = 2;
  static CLOSED = 3;
  readyState = FakeWebSocket.CONNECTING;
  bufferedAmount = 0;
  sent = [];
  closed = false;

  constructor(url) {
    this.url = url;
    FakeWebSocket.opened.push(this);
  }

  send(text) {
    this.sent.push(JSON.parse(text));
  }

  close() {
    this.closed = true;
  }

  said(op) {
    return this.sent.filter((message) => message.op === op);
  }

  open() {
    this.readyState = FakeWebSocket.OPEN;
    this.onopen({});
  }

  tell(message) {
    this.onmessage({ data: JSON.stringify(message) });
  }

  // Answers the newest clock sync, `aheadMs` being how far the sender's clock is ahead of the page's.
  answerClockSync(aheadMs) {
    const { t_ms } = this.said("clock_sync").at(-1);
    this.tell({ op: "clock_sync", t_ms, sender_ms: t_ms + aheadMs });
  }

  frame(options) {
    this.onmessage({ data: framed(options) });
  }

  end(code, reason = "") {
    this.onclose({ code, reason });
  }
}

// A link as rosbridge.js makes it, that notes what it is told and lets the test play the server.
export class FakeLink {
  /** @type {FakeLink[]} */
  static opened = []; // those of a test, which begins it anew
  static open = (url, handlers) => new FakeLink(url, handlers);
  subscribed = [];
  published = [];
  told = [];
  closed = false;
  backlog = 0;

  constructor(url, handlers) {
    Object.assign(this, handlers, { url });
    FakeLink.opened.push(this);
  }

  subscribe({ name }) {
    this.subscribed.push(name);
    return { end: () => this.subscribed.splice(this.subscribed.indexOf(name), 1) };
  }

  advertise() {
    return { publish: (message) => this.published.push(message) > 0, end() {} };
  }

  call() {
    return new Promise((resolve) => (this.answer = resolve));
  }

  send(operation) {
    return this.told.push(operation) > 0;
  }

  close(code) {
    Object.assign(this, { closed: true, code });
  }
}
