// A camera's frames, always the newest, each with its timestamp (docs/reference/media.md): opens a link, reports its state and
// opens the next one after a cut. Used by the drive page and, through index.js, by pages of others.
// It must never make a frame look newer than it is: driving is held by its age.

import { backoff } from "./api.js";
import { CreditWindow } from "./creditWindow.js";
import { parse } from "./rosbridge.js";

const OPEN_MS = 5000;
const CHECK_MS = 100;
const OLD_MS = 1000;
const FIRST_MS = 4000; // time limit for the first frame on an open link, which may be on its way; a sender waits as long for its camera

const BY_CODE = {
  1001: "restarting",
  4001: "rights_ended",
  4413: "slow",
  4429: "crowded",
  4503: "robot_offline",
  4505: "link_lost",
  4506: "video_down",
};

/** @type {Record<string, string | number | null>} */
const NO_DETAILS = { quality: null, width: null, height: null, fps: null, source: null, codec: null, encoder: null, no_encoder: null };

// `now()` may stand still while the machine sleeps, as performance.now() does; `wall()` goes on.
const BROWSER = {
  now: () => performance.now(),
  wall: () => Date.now(),
  openSocket: (/** @type {string} */ address) => new WebSocket(address),
};

export class FrameStream {
  // `url()` gives (a promise of) the address of the frames for each attempt, ticket included where it needs one, and may
  // throw what has a `status`, as TicketRefused has. `request` as in docs/reference/media.md; what is missing has its default there.
  // `onFrame({data, codec, isKey, sequence, at})`: `at` on the clock of `now()`, never later than it was; a promise that it gives is
  // waited for before the next frame is asked for. `onGap()`: the next frame does not continue those before it, so that what
  // depends on them waits for a key frame. `onStatus({frame, why, detail, bytes, quality ..})` at each change, with what is in
  // NO_DETAILS: `frame` is live, old (over OLD_MS) or none. `why` then is starting, paused, waiting, down
  // (the camera's source, with `detail`), old, cut, unreachable, login_missing, refused (`detail`: the server's reason) or of BY_CODE.
  /**
   * @param {{
   *   url: () => string | Promise<string>,
   *   request?: object,
   *   onFrame: (frame: {data: Uint8Array, codec: string, isKey: boolean, sequence: number, at: number}) => void | Promise<void>,
   *   onGap?: () => void,
   *   onStatus?: (status: any) => void,
   * } & Partial<typeof BROWSER>} options
   */
  constructor({ url, request = {}, onFrame, onGap = () => {}, onStatus = () => {}, ...browser }) {
    this.url = url;
    this.request = request;
    this.onFrame = onFrame;
    this.onGap = onGap;
    this.onStatus = onStatus;
    this.browser = { ...BROWSER, ...browser };
    this.round = 0;
    this.running = false;
    this.link = null;
    this.delays = backoff();
    /** @type {number | null} */
    this.at = null;
    this.details = NO_DETAILS;
    this.sender = { state: "", detail: "" };
    this.bytes = 0;
    this.reported = "";
  }

  start() {
    if (this.running) return;
    this.running = true;
    this.delays = backoff();
    this.forget("starting");
    this.watch = setInterval(() => this.checkAge(), CHECK_MS);
    this.attempt();
  }

  stop() {
    this.running = false;
    clearInterval(this.watch);
    this.endLink();
    this.forget("paused");
  }

  ask(changes) {
    this.request = { ...this.request, ...changes };
    this.link?.ask(this.request);
  }

  // What came cannot be decoded without one.
  requestKeyFrame() {
    this.link?.requestKeyFrame();
  }

  // Called when an attempt may work now.
  retryNow() {
    if (!this.running || this.link || this.asking) return;
    this.delays = backoff();
    this.attempt();
  }

  // The age of the newest frame in ms, or null without one.
  get ageMs() {
    return this.at === null ? null : this.browser.now() - this.at;
  }

  async attempt() {
    this.endLink();
    const { round } = this;
    const current = (act) => (value) => (round === this.round ? act(value) : undefined);
    this.asking = true;
    this.timer = setTimeout(() => this.fail("unreachable"), OPEN_MS);
    try {
      const url = await this.url();
      if (round === this.round) this.open(url, current);
    } catch (error) {
      current(() => this.refuse(error))();
    }
  }

  open(url, current) {
    const handlers = {
      request: this.request,
      onFrame: current((frame) => this.receiveFrame(frame)),
      onGap: current(() => this.onGap()),
      onStatus: current((status) => this.receiveStatus(status)),
      onEnd: current((how) => this.lose(how)),
      ...this.browser,
    };
    this.asking = false;
    clearTimeout(this.timer); // from here on the link itself watches for silence
    this.link = new FramesLink(this.browser.openSocket(url), handlers);
  }

  // It counts when it is to be seen: until then, and for ever if it cannot be shown, the page has the one before.
  async receiveFrame(frame) {
    const { round } = this;
    this.bytes += frame.bytes;
    await this.onFrame(frame);
    if (round !== this.round) return;
    this.delays = backoff();
    this.at = frame.at;
    this.sender = { state: "live", detail: "" };
    this.details = { ...this.details, quality: frame.quality || this.details.quality };
    this.checkAge();
  }

  receiveStatus({ state, detail = "", ...details }) {
    this.sender = { state, detail };
    for (const name of Object.keys(NO_DETAILS)) {
      if (name in details) this.details = { ...this.details, [name]: details[name] };
    }
    this.checkAge();
  }

  lose({ code, reason, opened }) {
    this.fail(BY_CODE[code] ?? (opened ? "cut" : "unreachable"), reason);
  }

  refuse(error) {
    if (!("status" in error)) throw error;
    const { status, code, detail = "" } = error;
    if (status === 401) this.fail("login_missing");
    else if (["robot_offline", "video_down"].includes(code)) this.fail(code, detail);
    else this.fail(status ? "refused" : "unreachable", status ? detail || `the server answered ${status}` : "");
  }

  fail(why, detail = "") {
    this.endLink();
    this.forget(why, detail);
    if (this.running) this.timer = setTimeout(() => this.attempt(), this.delays.next().value);
  }

  endLink() {
    this.round += 1;
    this.asking = false;
    clearTimeout(this.timer);
    this.link?.close();
    this.link = null;
    this.onGap();
  }

  // What was seen on a link that has ended is over.
  forget(why, detail = "") {
    this.at = null;
    this.details = NO_DETAILS;
    this.sender = { state: why, detail };
    this.checkAge();
  }

  checkAge() {
    const { ageMs } = this;
    const age = ageMs === null ? "none" : ageMs > OLD_MS ? "old" : "live";
    this.report({ frame: age, ...this.reason(age), ...this.details });
  }

  get isStarting() {
    return this.at === null && this.browser.now() - (this.link?.openedAt ?? -Infinity) < FIRST_MS;
  }

  reason(age) {
    const { state, detail } = this.sender;
    if (age === "live") return { why: "", detail: "" };
    if (state === "waiting" && this.isStarting) return { why: "starting", detail };
    if (state !== "live") return { why: state, detail };
    return { why: age === "old" ? "old" : "waiting", detail: "" };
  }

  report(status) {
    const reported = JSON.stringify(status);
    if (reported === this.reported) return;
    this.reported = reported;
    this.onStatus({ ...status, bytes: this.bytes });
  }
}

// One WebSocket of the frames protocol (docs/reference/media.md), from its opening to its end; FrameStream opens the next one.
// It must never have more frames under way than the page can show, or what it shows would be late.
const SYNC_MS = 500;
const SILENCE_MS = 4000; // time limit for silence of the sender, which answers every clock sync
const KEY_FRAME_MS = 500; // least interval between two requests of a key frame

class FramesLink {
  // `request` as in docs/reference/media.md. `onFrame` gets what readFrame gives, with `at` and `bytes`, and may give a promise: the
  // next frame is asked for when it has settled. `onGap` as of FrameStream, `onStatus` gets the sender's own,
  // `onEnd({code, reason, opened})` comes once.
  constructor(socket, { request, onFrame, onGap, onStatus, onEnd, now, wall }) {
    this.socket = socket;
    this.request = request;
    this.onFrame = onFrame;
    this.onGap = onGap;
    this.onStatus = onStatus;
    this.onEnd = onEnd;
    this.now = now;
    this.senderClock = new SenderClock({ now, wall });
    /** @type {Promise<unknown>} */
    this.turn = Promise.resolve();
    this.credits = new CreditWindow();
    this.taken = null;
    this.keyRequestedAt = -Infinity;
    this.lacksKey = false; // and has not asked for it yet
    this.opened = false;
    this.openedAt = now();
    this.receivedAt = now();
    this.timer = setInterval(() => this.tick(), SYNC_MS);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.open();
    socket.onmessage = ({ data }) => this.receive(data);
    socket.onclose = ({ code, reason }) => this.end(code, reason);
  }

  open() {
    this.opened = true;
    this.openedAt = this.receivedAt = this.now();
    this.send({ op: "stream_request", ...this.request });
    this.sendSync(); // before the first credit, so that the first frame's timestamp is known
    this.credit(0);
  }

  ask(request) {
    this.request = request;
    this.send({ op: "stream_request", ...request });
  }

  tick() {
    if (this.now() - this.receivedAt > SILENCE_MS) this.end(1006, "");
    else this.sendSync();
    if (this.lacksKey) this.requestKeyFrame();
  }

  // The sender gives no more of them; one that is asked for too early is asked for later.
  requestKeyFrame() {
    const now = this.now();
    this.lacksKey = now - this.keyRequestedAt < KEY_FRAME_MS;
    if (this.lacksKey) return;
    this.keyRequestedAt = now;
    this.send({ op: "key_frame" });
  }

  sendSync() {
    this.send({ op: "clock_sync", t_ms: this.now() });
  }

  credit(done) {
    const frames = this.credits.grant(done);
    if (frames) this.send({ op: "credit", frames, taken: this.taken });
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
    if (message?.op === "clock_sync") {
      this.senderClock.receive(message);
      this.credits.answered(this.now() - message.t_ms);
    }
    if (message?.op === "status") this.onStatus(message);
  }

  // In their order, one at a time.
  receiveFrame(data) {
    const frame = readFrame(data);
    this.credits.came(this.now(), frame?.codec);
    const at = frame && this.senderClock.timestamp(frame.timestampMs);
    if (frame) this.taken = frame.sequence;
    if (frame?.isKey) this.lacksKey = false;
    this.turn = this.turn.then(() => this.hand({ ...frame, at, bytes: data.byteLength }));
    this.turn = this.turn.then(() => this.credit(1));
  }

  // A frame that cannot be decoded is one that is skipped.
  async hand(frame) {
    if (this.onEnd && frame.at === null) this.onGap();
    else if (this.onEnd) await Promise.resolve(this.onFrame(frame)).catch(() => {});
  }

  // For a page that needs no more of it; nothing is reported any more.
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

// Takes a frame of the frames protocol (docs/reference/media.md) apart. Pure.
const LENGTH = 16; // Python's struct: !BBHId
const CODECS = { 1: "jpeg", 2: "h264", 3: "vp8" };
const KEY = 2;

// Gives {codec, isKey, sequence, quality, timestampMs, data}, the timestamp by the sender's clock; null for what this
// page cannot show, such as a codec of a newer server. Nothing is copied: its `data` is a view of the message.
export function readFrame(data) {
  if (data.byteLength <= LENGTH) return null;
  const view = new DataView(data);
  const timestampMs = view.getFloat64(8);
  const codec = CODECS[view.getUint8(0)];
  if (!codec || !Number.isFinite(timestampMs)) return null;
  return {
    codec,
    isKey: Boolean(view.getUint8(1) & KEY),
    sequence: view.getUint32(4),
    quality: view.getUint16(2),
    timestampMs,
    data: new Uint8Array(data, LENGTH),
  };
}

// Says when a frame was taken, by this page's clock (docs/reference/media.md, "Timestamps"). A sync is on its way for a while
// before the sender reads its clock, so each difference is at least the true one, and the least comes nearest: a
// timestamp is never later than the truth. Pure.
const MAX_AGE_MS = 30_000;
const STEP_MS = 250; // least step of a clock that counts as a sleep: over drift and over what browsers blur by

export class SenderClock {
  // `now()` and `wall()` as of BROWSER.
  constructor({ now, wall }) {
    this.now = now;
    this.wall = wall;
    this.samples = [];
  }

  // The answer to a sync that was asked at `t_ms` of `now()`.
  receive({ t_ms, sender_ms }) {
    if (!Number.isFinite(t_ms) || !Number.isFinite(sender_ms)) return;
    const at = this.now();
    this.samples = [...this.fresh(at), { at, ahead: sender_ms - t_ms, slept: this.wall() - at }];
  }

  // The timestamp on the clock of `now()`; null while nothing is known of the sender's clock.
  timestamp(sender_ms) {
    const now = this.now();
    const offsets = this.fresh(now).map(({ ahead }) => ahead);
    return offsets.length ? Math.min(now, sender_ms - Math.min(...offsets)) : null;
  }

  // After a sleep of this machine, what was known would make old frames look new.
  fresh(at) {
    const slept = this.wall() - at;
    return this.samples.filter((sample) => at - sample.at <= MAX_AGE_MS && Math.abs(slept - sample.slept) < STEP_MS);
  }
}
