// A camera's pictures, always the newest, each with its moment (docs/reference/media.md): opens a link, tells how it stands and
// opens the next one after a cut. Used by the drive page and, through index.js, by pages of others.
// It must never make a picture look newer than it is: driving is held by its age.

import { backoff } from "./backoff.js";
import { FramesLink } from "./framesLink.js";

const OPEN_MS = 5000;
const CHECK_MS = 100;
const OLD_MS = 1000;

const BY_CODE = {
  1001: "restarting",
  4001: "rights_ended",
  4413: "slow",
  4429: "crowded",
  4503: "robot_offline",
  4505: "link_lost",
  4506: "video_down",
};

const NO_DETAILS = { quality: null, width: null, height: null, fps: null, source: null };

export class FrameStream {
  // `url()` gives (a promise of) the address of the frames for each attempt, ticket included where it needs one, and may
  // throw what has a `status`, as TicketRefused has. `want` as in docs/reference/media.md; what is missing has its default there.
  // `onFrame({jpeg, number, at})`: `at` on the clock of `now()`, never later than it was; a promise that it gives is
  // waited for before the next picture is asked for. `onStatus({picture, why, detail, quality, width, height, fps, source,
  // bytes})` at each change: `picture` is live, old (over `oldMs`) or none. `why` then is starting, paused, waiting, down
  // (the camera's source, with `detail`), old, cut, unreachable, login_missing, refused (`detail`: the status) or of BY_CODE.
  constructor({
    url,
    want = {},
    onFrame,
    onStatus = () => {},
    oldMs = OLD_MS,
    now = () => performance.now(),
    wall = () => Date.now(),
    openSocket = (address) => new WebSocket(address),
  }) {
    Object.assign(this, { url, wanted: want, onFrame, onStatus, oldMs, now, wall, openSocket });
    this.round = 0;
    this.running = false;
    this.link = null;
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

  want(changes) {
    this.wanted = { ...this.wanted, ...changes };
    this.link?.want(this.wanted);
  }

  // For news that an attempt may work now.
  retryNow() {
    if (!this.running || this.link || this.asking) return;
    this.delays = backoff();
    this.attempt();
  }

  // The age of the newest picture in ms, or null without one.
  get ageMs() {
    return this.at === null ? null : this.now() - this.at;
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
      want: this.wanted,
      onFrame: current((frame) => this.receiveFrame(frame)),
      onStatus: current((status) => this.receiveStatus(status)),
      onEnd: current((how) => this.lose(how)),
      now: this.now,
      wall: this.wall,
    };
    this.asking = false;
    clearTimeout(this.timer); // from here on the link itself watches for silence
    this.link = new FramesLink(this.openSocket(url), handlers);
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
    const { status, code } = error;
    if (status === 401) this.fail("login_missing");
    else if (["robot_offline", "video_down"].includes(code)) this.fail(code);
    else this.fail(status ? "refused" : "unreachable", status ? String(status) : "");
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
  }

  // What was seen on a link that has ended is no picture any more.
  forget(why, detail = "") {
    this.at = null;
    this.details = NO_DETAILS;
    this.sender = { state: why, detail };
    this.checkAge();
  }

  checkAge() {
    const picture = this.at === null ? "none" : this.ageMs > this.oldMs ? "old" : "live";
    this.report({ picture, ...this.reason(picture), ...this.details });
  }

  reason(picture) {
    const { state, detail } = this.sender;
    if (picture === "live") return { why: "", detail: "" };
    if (state !== "live") return { why: state, detail };
    return { why: picture === "old" ? "old" : "waiting", detail: "" };
  }

  report(status) {
    const reported = JSON.stringify(status);
    if (reported === this.reported) return;
    this.reported = reported;
    this.onStatus({ ...status, bytes: this.bytes });
  }
}
