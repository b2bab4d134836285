// Test doubles of a page, of what a server sends and of WebCodecs, and what tests of the scripts wait with.

// Lets all go on that waits for an answer which has come; no mocked timer moves.
export async function settle(turns = 5) {
  for (let i = 0; i < turns; i++) await new Promise((resolve) => setImmediate(resolve));
}

// An element that stands inside exactly the given kind of element.
export const inside = (kind, more = {}) => ({ closest: (selector) => selector.split(", ").includes(kind) || null, ...more });

// As much of an element as the pages need; each of its parts is made when it is asked for.
export class FakeElement extends EventTarget {
  hidden = true;
  dataset = {};
  style = {};
  textContent = "";
  parts = new Map();
  querySelector(selector) {
    if (!this.parts.has(selector)) this.parts.set(selector, new FakeElement());
    return this.parts.get(selector);
  }
  querySelectorAll() {
    return [];
  }
  attributes = new Map();
  focus() {}
  getAttribute(name) {
    return this.attributes.get(name) ?? null;
  }
  setAttribute(name, value) {
    this.attributes.set(name, value);
  }
  removeAttribute(name) {
    this.attributes.delete(name);
  }
  parent = null;
  children = [];
  get firstElementChild() {
    return this.children[0] ?? null;
  }
  get nextElementSibling() {
    return this.parent.children[this.parent.children.indexOf(this) + 1] ?? null;
  }
  append(...children) {
    for (const child of children) this.insertBefore(child, null);
  }
  insertBefore(child, next) {
    if (child instanceof FakeElement) {
      child.remove();
      child.parent = this;
    }
    this.children.splice(next ? this.children.indexOf(next) : this.children.length, 0, child);
  }
  remove() {
    this.parent?.children.splice(this.parent.children.indexOf(this), 1);
    this.parent = null;
  }
  replaceChildren(...children) {
    for (const child of [...this.children]) child.remove();
    this.append(...children);
  }
  contains() {
    return false;
  }
}

// The browser's storage, in memory.
export const storageOf = (values = new Map()) => ({
  getItem: (name) => values.get(name) ?? null,
  setItem: (name, text) => values.set(name, text),
  removeItem: (name) => values.delete(name),
});

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

// A double of WebCodecs, which Node lacks: it decodes when the test says so.

export const bytes = (hex) => Uint8Array.from(hex.match(/../g), (pair) => parseInt(pair, 16));

// 640 x 480, and 4112 x 480: one macroblock more than may be across.
export const H264_KEY = bytes("000000016742c01eda0280f684000003000400000300f23c58ba800000000168ce0fc8");
export const HUGE_KEY = bytes("000000016742c01eda004043d9");

// 640 x 480, without its content.
export const JPEG = bytes("ffd8ffe00004ffc0ffc0000b0801e00280");

export class FakeVideoDecoder {
  /** @type {FakeVideoDecoder[]} */
  static made = [];

  static install() {
    FakeVideoDecoder.made = [];
    globalThis.VideoDecoder = FakeVideoDecoder;
    globalThis.EncodedVideoChunk = class {
      constructor(chunk) {
        Object.assign(this, chunk);
      }
    };
  }

  state = "unconfigured";
  chunks = [];

  constructor({ output, error }) {
    this.output = output;
    this.onError = error;
    FakeVideoDecoder.made.push(this);
  }

  configure(config) {
    this.config = config;
    this.state = "configured";
  }

  decode(chunk) {
    if (this.state !== "configured") throw new Error(`cannot decode: ${this.state}`);
    this.chunks.push(chunk);
  }

  close() {
    this.state = "closed";
  }

  error(error) {
    this.state = "closed";
    this.onError(error);
  }

  give(timestamp = this.chunks.at(-1).timestamp, more = {}) {
    const image = { timestamp, codedWidth: 640, codedHeight: 480, close: () => (image.closed = true), ...more };
    this.output(image);
    return image;
  }
}
