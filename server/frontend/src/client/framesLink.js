// One WebSocket of the frames protocol (docs/reference/media.md), from its opening to its end; frames.js opens the next one.
// It must never have more pictures under way than the page can show, or what it shows would be late.

const CREDITS = 2; // one is shown while the next is on its way
const SYNC_MS = 500;
const SILENCE_MS = 4000; // every beat is answered

export class FramesLink {
  // `want` as in docs/reference/media.md. `onFrame({jpeg, number, at, quality, byCamera, bytes})` may give a promise: the next
  // picture is asked for when it has settled. `onStatus` gets the sender's own, `onEnd({code, reason, opened})` comes once.
  constructor(socket, { want, onFrame, onStatus, onEnd, now, wall }) {
    Object.assign(this, { socket, wanted: want, onFrame, onStatus, onEnd, now });
    this.senderClock = new SenderClock({ now, wall });
    this.turn = Promise.resolve();
    this.taken = null;
    this.opened = false;
    this.receivedAt = now();
    this.timer = setInterval(() => this.tick(), SYNC_MS);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.open();
    socket.onmessage = ({ data }) => this.receive(data);
    socket.onclose = ({ code, reason }) => this.end(code, reason);
  }

  open() {
    this.opened = true;
    this.receivedAt = this.now();
    this.send({ op: "want", ...this.wanted });
    this.sendSync(); // before the first credit, so that the first picture's moment is known
    this.credit(CREDITS);
  }

  want(want) {
    this.wanted = want;
    this.send({ op: "want", ...want });
  }

  tick() {
    if (this.now() - this.receivedAt > SILENCE_MS) this.end(1006, "");
    else this.sendSync();
  }

  sendSync() {
    this.send({ op: "beat", t_ms: this.now() });
  }

  credit(frames) {
    this.send({ op: "credit", frames, taken: this.taken });
  }

  // What cannot be said now is said anew when it opens, or has no meaning any more.
  send(message) {
    if (this.opened && this.onEnd) this.socket.send(JSON.stringify(message));
  }

  receive(data) {
    if (!this.onEnd) return;
    this.receivedAt = this.now();
    if (typeof data === "string") this.receiveText(data);
    else this.receiveFrame(data);
  }

  receiveText(text) {
    const message = parse(text);
    if (message?.op === "beat") this.senderClock.receive(message);
    if (message?.op === "status") this.onStatus(message);
  }

  // In their order, one at a time.
  receiveFrame(data) {
    const frame = readFrame(data);
    const at = frame && this.senderClock.timestamp(frame.timestampMs);
    if (frame) this.taken = frame.number;
    this.turn = this.turn.then(() => at !== null && this.hand({ ...frame, at, bytes: data.byteLength }));
    this.turn = this.turn.then(() => this.credit(1));
  }

  // A picture that cannot be decoded is one that is skipped.
  async hand(frame) {
    if (this.onEnd) await Promise.resolve(this.onFrame(frame)).catch(() => {});
  }

  // For a page that needs no more of it; nothing is told any more.
  close() {
    this.onEnd = null;
    clearInterval(this.timer);
    this.socket.close();
  }

  end(code, reason) {
    const { onEnd } = this;
    if (!onEnd) return;
    this.close();
    onEnd({ code, reason, opened: this.opened });
  }
}

function parse(text) {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

// Takes a picture of the frames protocol (docs/reference/media.md) apart. Pure.
const LENGTH = 16; // Python's struct: !BBHId
const JPEG = 1;
const CAMERA_STAMP = 1;

// Gives {number, quality, byCamera, timestampMs, jpeg}, the moment by the sender's clock; null for what this page
// cannot show, such as a codec of a newer server. Nothing is copied: `jpeg` is a view of `data`.
export function readFrame(data) {
  if (data.byteLength <= LENGTH) return null;
  const view = new DataView(data);
  const timestampMs = view.getFloat64(8);
  if (view.getUint8(0) !== JPEG || !Number.isFinite(timestampMs)) return null;
  return {
    number: view.getUint32(4),
    quality: view.getUint16(2),
    byCamera: Boolean(view.getUint8(1) & CAMERA_STAMP),
    timestampMs,
    jpeg: new Uint8Array(data, LENGTH),
  };
}

// Tells when a picture was taken, by this page's clock (docs/reference/media.md, "SenderClock"). A beat is on its way for a while
// before the sender reads its clock, so each difference is at least the true one, and the least comes nearest: a
// moment is never told later than it was. Pure.
const MAX_AGE_MS = 30_000;
const STEP_MS = 250; // over what clocks drift in that time, and over what browsers blur them by

export class SenderClock {
  // `now()` may stand still while the machine sleeps, as performance.now() does; `wall()` goes on.
  constructor({ now, wall }) {
    Object.assign(this, { now, wall });
    this.samples = [];
  }

  // The answer to a beat that was asked at `t_ms` of `now()`.
  receive({ t_ms, sender_ms }) {
    if (!Number.isFinite(t_ms) || !Number.isFinite(sender_ms)) return;
    const at = this.now();
    this.samples = [...this.fresh(at), { at, ahead: sender_ms - t_ms, slept: this.wall() - at }];
  }

  // The moment on the clock of `now()`; null while nothing is known of the sender's clock.
  timestamp(sender_ms) {
    const now = this.now();
    const known = this.fresh(now).map(({ ahead }) => ahead);
    return known.length ? Math.min(now, sender_ms - Math.min(...known)) : null;
  }

  // After a sleep of this machine, what was known would make old pictures look new.
  fresh(at) {
    const slept = this.wall() - at;
    return this.samples.filter((sample) => at - sample.at <= MAX_AGE_MS && Math.abs(slept - sample.slept) < STEP_MS);
  }
}
