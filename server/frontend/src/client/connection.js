// A rosbridge connection that stays: it gets a ticket for each attempt, tries again after a cut, and
// gives every new link the subscriptions and publishers of the page.
// It must never send on a new link what was meant for an old one.

import { because, explained, reasons } from "../texts/common.js";
import { TicketRefused, backoff } from "./api.js";

/** @typedef {import("./rosbridge.js").Link} Link */

const TICKET_MS = 10_000; // time limit for a ticket, over that of the API; a page's own function may have none
const OPEN_MS = 5000; // time limit for the WebSocket to open
const ANSWER_MS = 8000; // time limit for the robot's first answer, over the 5 s of rosbridge for a service
const SILENCE_MS = 6000; // time limit for silence of the robot
const WATCH_MS = 1000; // interval between checks of it

/** @type {{onLeaving: () => void, onLink: (send: ((operation: object) => boolean) | null) => void, onOwn: (operation: any) => void}} */
const NO_HANDLERS = { onLeaving() {}, onLink() {}, onOwn() {} };

export class Connection {
  // `requestTicket()` gives a URL, `openLink(url, handlers)` a link as in rosbridge.js. `prepare(call)` asks the
  // robot what the page must know of it, on every new link before that one counts as live.
  // `onLeaving()` is the last chance to say something on a live link that this page gives up.
  // `onLink(send)` comes with each link that opens, and with null when it ends; `onOwn(operation)` with what
  // the relay says on it in operations of our own. A live link on which the robot is silent for `maxSilenceMs` is lost.
  /**
   * @param {{
   *   requestTicket: () => Promise<string>,
   *   openLink: (url: string, handlers: import("./rosbridge.js").LinkHandlers) => Link,
   *   prepare?: (call: Link["call"]) => Promise<void>,
   *   onState: (state: State) => void,
   *   maxSilenceMs?: number,
   *   now?: () => number,
   * } & Partial<typeof NO_HANDLERS>} options
   */
  constructor({
    requestTicket,
    openLink,
    prepare = async () => {},
    onState,
    maxSilenceMs = SILENCE_MS,
    now = () => performance.now(),
    ...handlers
  }) {
    this.requestTicket = requestTicket;
    this.openLink = openLink;
    this.prepare = prepare;
    this.onState = onState;
    this.maxSilenceMs = maxSilenceMs;
    this.now = now;
    this.handlers = { ...NO_HANDLERS, ...handlers };
    this.state = CONNECTING;
    this.delays = backoff();
    this.attempt = 0;
    /** @type {Link | null} */
    this.link = null;
    this.receivedAt = this.checkedAt = -Infinity;
    this.yielded = false;
    this.started = false;
    this.topics = new Set();
    this.calls = new Set(); // functions that end a call without an answer
  }

  start() {
    this.started = true;
    this.delays = backoff();
    this.state = CONNECTING;
    this.watch = setInterval(() => this.checkSilence(), WATCH_MS);
    this.onState(this.state);
    this.connect();
  }

  stop() {
    this.started = false;
    clearInterval(this.watch);
    this.leave();
  }

  get live() {
    return this.link !== null && this.state.name === "live";
  }

  // Whether there is no link and the page tries for one again and again, as while the robot is offline.
  get waits() {
    return this.state.retry && !["live", "connecting"].includes(this.state.name);
  }

  get backlog() {
    return this.link ? this.link.backlog : 0;
  }

  // How long a live link has brought nothing.
  get silenceMs() {
    return this.now() - this.receivedAt;
  }

  // Called when an attempt may work now; `asked` when a person wants it, whatever the state.
  // Without effect on a live link, during an attempt, or once it was stopped.
  retryNow({ asked = false } = {}) {
    if (!this.started || this.live || this.connecting || !(asked || this.state.retry)) return;
    this.delays = backoff();
    this.connect();
  }

  // For another ticket, as the page drives from now on or watches; `code` as of Link.close.
  /** @param {number} [code] */
  reopen(code) {
    this.delays = backoff();
    this.leave(code);
    this.show(CONNECTING);
    this.connect();
  }

  // Says an operation of our own on an open link, live or not, or not at all; gives which.
  send(operation) {
    return this.link !== null && this.link.send(operation);
  }

  // Gives the function that ends the subscription.
  /** @type {(spec: import("./rosbridge.js").TopicSpec, handler: (message: any) => void) => () => void} */
  subscribe(spec, handler) {
    const entry = this.keep((link) => link.subscribe(spec, handler));
    return () => this.release(entry);
  }

  // Gives {publish, end}; publish drops the message unless the link is live, and says whether it went.
  /** @param {import("./rosbridge.js").TopicSpec} spec */
  advertise(spec) {
    const entry = this.keep((link) => link.advertise(spec));
    return {
      end: () => this.release(entry),
      publish: (message, stamp) => entry.channel?.publish(message, stamp) ?? false,
    };
  }

  // Rejects when there is no live link, or when it ends before the answer. `timeoutS` is rosbridge's time limit.
  async call(service, request = {}, type = undefined, timeoutS = undefined) {
    if (!this.live) throw new Error(`cannot call ${service}: not connected`);
    const answer = /** @type {Link} */ (this.link).call(service, request, type, timeoutS);
    return new Promise((resolve, reject) => {
      const end = () => reject(new Error(`cannot call ${service}: the connection ended before the answer; it may still run`));
      this.calls.add(end);
      answer.then(resolve, reject).finally(() => this.calls.delete(end));
    });
  }

  keep(attach) {
    const entry = { attach, channel: /** @type {any} */ (null) };
    this.topics.add(entry);
    if (this.live) entry.channel = attach(this.link);
    return entry;
  }

  release(entry) {
    this.topics.delete(entry);
    entry.channel?.end();
    entry.channel = null;
  }

  async connect() {
    clearTimeout(this.timer);
    this.connecting = true;
    const attempt = ++this.attempt;
    this.timer = setTimeout(() => this.settle(NOT_OPENED), TICKET_MS);
    try {
      const url = await this.requestTicket();
      if (attempt === this.attempt) this.open(url);
    } catch (error) {
      if (!(error instanceof TicketRefused)) throw error;
      if (attempt === this.attempt) this.settle(afterTicketRefusal(error));
    }
  }

  open(url) {
    const attempt = this.attempt;
    clearTimeout(this.timer);
    const current = (act) => (value) => attempt === this.attempt && act(value);
    this.link = this.openLink(url, {
      onOpen: current(() => this.confirm()),
      onMessage: current(() => (this.receivedAt = this.now())),
      onOwn: current((operation) => this.handlers.onOwn(operation)),
      onClose: current(({ code, reason }) => this.settle({ ...afterClose({ code, reason, wasLive: this.live }), code })),
    });
    this.timer = setTimeout(() => this.settle(NOT_OPENED), OPEN_MS);
  }

  // The server opens the WebSocket before it knows whether the robot answers, so that it can close it
  // with a reason. Only an answer from the robot itself makes the link live.
  async confirm() {
    const { attempt } = this;
    const link = /** @type {Link} */ (this.link);
    this.handlers.onLink((operation) => link.send(operation));
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.settle(ROSBRIDGE_SILENT), ANSWER_MS);
    await this.prepare((service, request) => link.call(service, request));
    if (attempt === this.attempt) this.becomeLive();
  }

  becomeLive() {
    clearTimeout(this.timer);
    this.connecting = false;
    this.delays = backoff();
    this.yielded = false;
    this.receivedAt = this.now();
    for (const entry of this.topics) entry.channel = entry.attach(this.link);
    this.show(LIVE);
  }

  // Called when the network is gone: the browser may keep a dead link open for minutes.
  cut() {
    if (this.live) this.settle(LINK_LOST);
  }

  // A network that goes away silently closes nothing: the answers just stop. So they do while the browser slows the timers of
  // a page in the background, which ask for them.
  checkSilence() {
    const late = this.now() - this.checkedAt > 2 * WATCH_MS;
    this.checkedAt = this.now();
    if (!late && this.live && this.silenceMs > this.maxSilenceMs) this.settle(LINK_LOST);
  }

  settle(state) {
    this.leave();
    this.show(state);
    if (state.retry && this.started) this.timer = setTimeout(() => this.connect(), this.delay(state));
  }

  // Whoever loses the control sees on at once; but were that refused too, the next attempt has to wait.
  delay({ lost }) {
    const hurry = Boolean(lost) && !this.yielded;
    this.yielded = hurry;
    return hurry ? 0 : this.delays.next().value;
  }

  /** @param {number} [code] */
  leave(code) {
    clearTimeout(this.timer);
    if (this.live) this.handlers.onLeaving();
    this.dropLink(code);
    this.connecting = false;
  }

  /** @param {number} [code] */
  dropLink(code) {
    this.attempt += 1;
    const { link } = this;
    this.link = null; // first: who hears that it is gone must not find it live
    if (link) this.handlers.onLink(null);
    link?.close(code);
    for (const entry of this.topics) entry.channel = null;
    for (const end of this.calls) end();
    this.calls.clear();
  }

  show(state) {
    this.state = state;
    this.onState(state);
  }
}

// Resolves with `owner` when its connection stands, and rejects when it never will; `what` names it.
export function whenLive(owner, what) {
  return new Promise((resolve, reject) => {
    const end = owner.on("state", ({ name, retry, reason }) => {
      if (name !== "live" && retry) return;
      end();
      if (name === "live") resolve(owner);
      else reject(new Error(`cannot connect ${what}: ${reason || name}`));
    });
  });
}

// What a closed connection or a refused ticket means: the state to show, whether to try again, and in `lost`
// why this page may no longer drive.
// Pure. Close codes are those of docs/reference/protocols.md.

/**
 * @typedef {{name: string, reason: string, retry: boolean, lost?: string, login?: boolean, gone?: boolean, code?: number}} State
 * `gone`: this user sees no robot of this name any more; `code`: of the close
 */

/** @returns {State} */
const retrying = (name, reason = "") => ({ name, reason, retry: true });
// The robot is there, but this page no longer drives it: it goes on as an observer, at once.
const lostControl = (lost) => (reason) => ({ ...retrying("connecting", reason), lost });
const final = (name, reason = "", login = false) => ({ name, reason, retry: false, login });

export const GIVE_UP = 4000; // with which this side closes, so that the record says that its driver gave up control
export const TOO_BIG = 1009; // a message, for the server
export const RIGHTS_ENDED = 4001; // or other settings: the next ticket shows what is left

const BY_CLOSE_CODE = {
  1001: (reason) => retrying("server_unreachable", explained(reason, reasons.restarting)),
  1008: (reason) => retrying("link_lost", reason),
  [TOO_BIG]: (reason) => retrying("link_lost", reason),
  [RIGHTS_ENDED]: () => retrying("connecting"),
  4002: lostControl("superseded"),
  4003: lostControl("robot_stopped"),
  4009: lostControl("lease_held"),
  4010: lostControl("lease_lost"),
  4408: (reason) => retrying("link_lost", reason),
  4413: (reason) => retrying("link_lost", reason),
  4429: (reason) => retrying("server_unreachable", explained(reason, reasons.crowded)),
  4503: (reason) => retrying("offline", reason),
  4504: (reason) => retrying("rosbridge_down", reason),
  4505: (reason) => retrying("link_lost", reason),
  4510: (reason) => retrying("lease_unavailable", reason),
};

export const CONNECTING = retrying("connecting");
export const LIVE = retrying("live");
/** @type {State} */
export const CLOSED = final("closed"); // by the page itself
export const LINK_LOST = retrying("link_lost");
const NOT_OPENED = retrying("server_unreachable");
const ROSBRIDGE_SILENT = retrying("rosbridge_down");

// A code that is not listed is a cut by the network (1006) or by something in between, or a fault that the server explains.
export function afterClose({ code, reason = "", wasLive = false }) {
  const verdict = BY_CLOSE_CODE[code];
  if (verdict) return verdict(reason);
  if (wasLive) return retrying("link_lost", reason);
  return retrying("server_unreachable", reason && explained(reason, reasons.trying));
}

// `status` 0 stands for a server that gave no answer at all.
/** @param {{status: number, code: string, detail?: string}} refusal */
export function afterTicketRefusal({ status, code, detail }) {
  const why = (usual, advice) => `${detail ? because(detail) : usual} ${advice}`;
  if (status === 401) return final("not_allowed", reasons.login, true);
  if (status === 404) return { ...final("not_allowed", reasons.robot), gone: true };
  if (code === "grant_missing") return final("not_allowed", why(reasons.changed, reasons.grant));
  if ([400, 403].includes(status)) return final("not_allowed", why(reasons.stale, reasons.reload));
  const usual = { 0: "", 429: reasons.busy }[status] ?? reasons.trouble;
  return retrying("server_unreachable", (usual || detail) && why(usual, reasons.trying));
}
