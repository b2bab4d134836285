// robotether-client: a robot behind Robotether, for pages of others (docs/reference/client.md). Bundled into
// dist/robotether-client.js; the drive page is made of the same parts.

import { DecoderChoice, FrameDecoder } from "../decoders/frameDecoder.js";
import { jpegBlob } from "../decoders/jpeg.js";
import { reasons } from "../texts/common.js";
import { Api, TicketRefused, credentials, framesUrl, requestTicket, rosUrl, streamUrl, ticketBy } from "./api.js";
import { App } from "./app.js";
import { CLOSED, GIVE_UP, whenLive } from "./connection.js";
import { Driver } from "./driver.js";
import { DriveTypeQuery } from "./driveType.js";
import { FrameStream } from "./frames.js";
import { Painter } from "./painter.js";
import { fullName } from "./rosbridge.js";
import { Session, randomKey } from "./session.js";
import { ShownFrames, oldestSeen } from "./shownFrames.js";

const USUAL = { token: null, getTicket: null, driveTopic: "/cmd_vel", driveType: null, wheelbase: null, letGoOnBlur: true };
const MODULE = "/static/dist/robotether-client.js";
const USUAL_CAMERA = "/camera/image_raw";
const STOP_CONFIRM_MS = 3000;
const CANVAS = "canvas"; // an <img> shows JPEG alone
const FRESH_MS = 2000; // time for which what was measured says how it is; both come at least each second

export class Robot {
  // `server`: https://HOST, by default the page's own. The caller: `token`, an API token; or `getTicket({robot, mode})`, which
  // gives (a promise of) a ticket, from a backend of yours; or else the login of a page on that server.
  // `driveType` and `wheelbase` where the robot does not report its type or steers; `letGoOnBlur` false for a page that drives
  // by a program and needs nobody to look at it. `mac`: of the robot that is meant, as another one may get its name.
  constructor(options) {
    const { robot, mac, server, token, getTicket, driveTopic, driveType, wheelbase, letGoOnBlur } = {
      ...USUAL,
      server: location.origin,
      ...options,
    };
    checkWheelbase(wheelbase);
    this.name = robot;
    this.mac = mac;
    this.server = server;
    this.getTicket = getTicket;
    this.driveTopic = driveTopic && fullName(driveTopic); // empty: it drives nothing
    this.driveType = driveType;
    this.driveTypeQuery = new DriveTypeQuery({ topic: this.driveTopic });
    this.api = getTicket && !token ? null : new Api({ server, headers: credentials(token) });
    this.handlers = { state: new Set(), control: new Set() };
    this.mode = "drive";
    this.control = null;
    /** @type {number | null} */
    this.roundTripMs = null;
    this.publishers = new Map();
    this.decoderChoice = new DecoderChoice();
    this.hasVideo = false; // whether showVideo was called
    this.shown = new Set(); // {topic, stream, frames}, of each camera that showVideo has shown
    /** @type {{ageMs: number | null, at: number} | null} */
    this.seen = null; // the newest report of this link
    this.session = new Session({
      driveTopic: this.driveTopic,
      wheelbase,
      requestUrl: async () => rosUrl(server, robot, await this.ticket(this.mode)),
      prepare: (call) => this.readDriveType(call),
      onState: (state) => this.showState(state),
      onLeaving: () => this.driver.letGo(),
      onControl: (control) => this.receive(control),
      onRoundTrip: (reading) => (this.roundTripMs = reading && reading.ageMs <= FRESH_MS ? reading.medianMs : null),
      seenAt: (timestamp) => this.seenAt(timestamp),
      onSeen: ({ ageMs }) => (this.seen = { ageMs, at: performance.now() }),
    });
    this.driver = new Driver({ output: this.session });
    this.letGoOnBlur = letGoOnBlur;
    /** @type {AbortController | null} */
    this.listening = null; // until close(), or the page would keep what it has closed
  }

  // `mode`: "drive" or "observe". Resolves when the robot answers, and rejects when it never will: look at `state`
  // then. From then on it connects again by itself after each cut. Called again, it goes on in that mode.
  connect({ mode = "drive" } = {}) {
    const gaveUp = this.driving && mode === "observe";
    this.mode = mode;
    const { connection } = this.session;
    const settled = whenLive(this, `to ${this.name}`);
    if (this.begun) connection.reopen(gaveUp ? GIVE_UP : undefined);
    else this.begin();
    return settled;
  }

  begin() {
    this.begun = true;
    this.listening = new AbortController();
    this.listen(this.listening);
    this.session.connection.start();
  }

  close() {
    this.session.stop(); // first: what moves gets its zero
    this.driver.arm(false);
    this.begun = false;
    this.listening?.abort();
    this.notifyState(CLOSED);
  }

  // "state" with {name, reason, driving} at each change of the connection, as src/client/connection.js names them; "control" with
  // who drives, who asks and whether the robot is stopped, as docs/reference/protocols.md has it. Gives the function that ends it.
  on(event, handler) {
    this.handlers[event].add(handler);
    return () => this.handlers[event].delete(handler);
  }

  // Whether what drive() says goes to the robot now.
  get driving() {
    return this.session.connection.live && this.mode === "drive";
  }

  // How old was what the driver saw; null for unknown, as of what nobody measured lately.
  get seenAgeMs() {
    return this.seen && performance.now() - this.seen.at <= FRESH_MS ? this.seen.ageMs : null;
  }

  // {forward, left, turn} in m/s, m/s and rad/s. To be called again within 0.3 s, or the robot gets zero, and then only
  // after a call with zero does the next one count; so it is after each cut. Gives whether it counts.
  drive(twist) {
    return this.driver.drive(twist);
  }

  // Ends all motion that this page asked for, and latches the robot's Stop. Gives whether the server has it, by its answer
  // or by its word on the connection: what was only sent may be on a dead link.
  async stop() {
    this.driver.halt();
    const confirmation = this.awaitStop();
    const press = randomKey();
    this.session.stopRobot(press);
    const answer = await this.api?.stop(this.name, press, this.mac);
    return Boolean(answer?.ok) || confirmation;
  }

  awaitStop() {
    return new Promise((resolve) => {
      const settle = (confirmed) => {
        clearTimeout(timer);
        ends.forEach((end) => end());
        resolve(confirmed);
      };
      const timer = setTimeout(() => settle(false), STOP_CONFIRM_MS);
      const ends = [
        this.on("control", ({ stopped }) => stopped && settle(true)),
        this.on("state", ({ lost }) => lost === "robot_stopped" && settle(true)),
      ];
    });
  }

  // Lets the stopped robot be driven again, if the stop is the one that was reported to this page. Its wheels stay still until
  // the next connect and drive.
  async release() {
    const stopped = this.control?.stopped;
    await this.ask("release", (api) => {
      if (!stopped) throw new Error(`cannot release ${this.name}: no stop was reported to this page`);
      return api.release(this.name, stopped, this.mac);
    });
  }

  // `action`: ask, withdraw, hand_over, refuse or take.
  async lease(action, more) {
    await this.ask(action, (api) => api.lease(this.name, action, more, this.mac));
  }

  // `outcome` says what is known when no answer comes.
  async ask(what, act, outcome = "") {
    if (!this.api) throw new Error(`cannot ${what} ${this.name}: that needs a token or a login`);
    const answer = await act(this.api);
    const { ok, code, detail } = answer;
    if (!ok) throw Object.assign(new Error(detail || `cannot ${what} ${this.name}: no answer${outcome}`), { code });
    return answer;
  }

  // Without a connection, over HTTP: {message, received_age_s, sequence} of the newest message, null when none came in `waitS`.
  // `since` is the `sequence` of one that is no more wanted.
  async newest(topic, /** @type {{type?: string, throttleMs?: number, waitS?: number, since?: string}} */ options = {}) {
    const { type, throttleMs, waitS, since } = options;
    const query = { type, throttle_rate: throttleMs, wait_s: waitS, since, mac: this.mac };
    const { status, body } = await this.ask(`read ${topic} of`, (api) => api.topic(this.name, topic, query));
    return status === 204 ? null : body;
  }

  // Without a connection, over HTTP. Resolves with the answer's values.
  async callOnce(service, args = {}, /** @type {{type?: string, timeoutS?: number}} */ { type, timeoutS } = {}) {
    const query = { type, timeout_s: timeoutS, mac: this.mac };
    const { body } = await this.ask(`call ${service} of`, (api) => api.service(this.name, service, args, query), "; it may still run");
    if (!body.result) throw new Error(`cannot call ${service}: ${body.reason}`);
    return body.values;
  }

  // Gives the function that ends the subscription. It outlives cuts. `onRefused(why)` when server or robot do not give the topic.
  subscribe(topic, handler, /** @type {{type?: string, throttleMs?: number, onRefused?: (why: string) => void}} */ options = {}) {
    return this.session.connection.subscribe({ ...options, name: fullName(topic) }, handler);
  }

  // Lets the robot know the topic before the first message: ROS loses what is published before subscribers have found it.
  // `onRefused(why)` for each message that the server refuses.
  advertise(topic, type, /** @type {{onRefused?: (why: string) => void}} */ { onRefused } = {}) {
    const name = fullName(topic);
    if (name === this.driveTopic) throw new Error(`cannot publish on ${topic}: drive() does, with each command's timestamp`);
    if (!this.publishers.has(name)) this.publishers.set(name, this.session.connection.advertise({ name, type, onRefused }));
  }

  // Gives whether it went; the server may still refuse it, as `onRefused` of advertise() is told.
  publish(topic, type, message) {
    this.advertise(topic, type);
    return this.publishers.get(fullName(topic)).publish(message);
  }

  // Resolves with the answer's values.
  async call(service, args = {}, type = undefined) {
    const { ok, values } = await this.session.connection.call(service, args, type);
    if (!ok) throw new Error(`cannot call ${service}: ${typeof values === "string" ? values : "it failed"}`);
    return values;
  }

  // Shows a camera in an <img> or <canvas>, always the newest frame. `request` as in docs/reference/media.md. Gives the stream:
  // stop(), ask(changes), ageMs of the newest frame.
  showVideo(
    element,
    /** @type {{topic?: string, onStatus?: (status: object) => void}} */ { topic = USUAL_CAMERA, onStatus, ...request } = {},
  ) {
    const { decoderChoice: choice } = this;
    const askAnew = () => stream.ask({ codecs: choice.codecs });
    const decoder = new FrameDecoder({ choice, onKeyFrame: () => stream.requestKeyFrame(), onCodecs: askAnew });
    const [show, frames] = [showOn(element, decoder), new ShownFrames()];
    const stream = new FrameStream({
      url: async () => framesUrl(this.server, this.name, topic, { ticket: await this.viewTicket(), mac: this.mac }),
      request,
      onFrame: async (frame) => {
        await show(frame);
        this.shown.add(shown); // after its end, too: what was seen stays in the driver's mind, and grows old
        frames.draw(frame);
      },
      onGap: () => decoder.close(),
      onStatus,
    });
    const shown = { topic, stream, frames };
    this.hasVideo = true;
    if (element.localName === CANVAS) choice.ready.then(askAnew);
    stream.start();
    return stream;
  }

  // The frames that the driver saw: of the cameras that are shown now, else of the last ones; none before the first frame, so that
  // the robot is at its slowest. A page without video names none at all.
  seenAt(timestamp) {
    const running = [...this.shown].filter(({ stream }) => stream.running);
    if (running.length) this.shown = new Set(running);
    return this.hasVideo ? oldestSeen([...this.shown], timestamp) : undefined;
  }

  // An address for <img src>, good for 30 s to begin with. Prefer showVideo: it comes back after a cut.
  async streamUrl({ topic = USUAL_CAMERA, ...more } = {}) {
    return streamUrl(this.server, this.name, topic, await this.viewTicket(), { ...more, mac: this.mac });
  }

  // A login goes by its cookie.
  viewTicket() {
    const byLogin = this.api && !this.api.headers().Authorization;
    return byLogin ? undefined : this.ticket("observe");
  }

  ticket(mode) {
    const meant = this.mac ? { mac: this.mac } : {};
    if (this.getTicket) return ticketBy(this.getTicket, { robot: this.name, mode, ...meant });
    return requestTicket(this.api, this.name, mode, meant);
  }

  async readDriveType(call) {
    const type = await this.driveTypeQuery.find(call);
    this.session.useType(this.driveType ?? type);
  }

  showState(state) {
    if (state.lost) this.mode = "observe"; // somebody else drives: this page looks on
    if (state.name !== "live") this.seen = null;
    this.session.use(this.driving);
    this.driver.arm(this.driving);
    this.notifyState(state);
    if (state.name === "server_unreachable" && !state.reason) this.explainUnreachable(state);
  }

  notifyState(state) {
    for (const handler of [...this.handlers.state]) handler({ ...state, driving: this.driving });
  }

  // To a page of a site that the server refuses, a browser shows a server that does not answer; but every site may load this module.
  async explainUnreachable(state) {
    if (new URL(this.server).origin === location.origin) return;
    const request = { method: "HEAD", cache: /** @type {RequestCache} */ ("no-store") };
    const answers = await fetch(`${this.server}${MODULE}`, request)
      .then(({ ok }) => ok)
      .catch(() => false);
    if (answers && this.session.connection.state === state) this.notifyState({ ...state, reason: reasons.site(location.origin) });
  }

  receive(control) {
    this.control = control;
    for (const handler of [...this.handlers.control]) handler(control);
  }

  listen({ signal }) {
    const { connection } = this.session;
    window.addEventListener("offline", () => connection.cut(), { signal });
    window.addEventListener("online", () => connection.retryNow(), { signal });
    if (!this.letGoOnBlur) return;
    const letGo = () => this.driver.letGo(); // nobody may be looking at the page
    for (const name of ["blur", "pagehide"]) window.addEventListener(name, letGo, { signal });
    for (const name of ["visibilitychange", "freeze", "resume"]) document.addEventListener(name, letGo, { signal });
  }
}

// 0 would drive straight on, whatever turn is asked for, and less than 0 to the other side.
function checkWheelbase(metres) {
  if (metres === null || (Number.isFinite(metres) && metres > 0)) return;
  throw new TypeError(`cannot steer: wheelbase is ${metres}, and must be a number of metres`);
}

export { App, FrameStream, TicketRefused };

// Shows frames in an <img> or on a <canvas> of the page, one at a time.
// Gives the function that shows a frame and settles when it is to be seen; it rejects for what is not an image.
function showOn(element, decoder) {
  if (element.localName === CANVAS) return canvasShower(element, decoder);
  if (element.localName === "img") return imageShower(element);
  throw new TypeError(`cannot show video in <${element.localName}>: give an <img> or a <canvas>`);
}

// The canvas stays as the page has it until the first frame.
function canvasShower(canvas, decoder) {
  /** @type {Painter | undefined} */
  let painter;
  return async (frame) => {
    const image = await decoder.decode(frame);
    painter ??= new Painter(canvas);
    painter.show(image);
  };
}

function imageShower(img) {
  /** @type {string | null} */
  let url = null;
  return async ({ data }) => {
    const before = url;
    url = URL.createObjectURL(jpegBlob(data));
    try {
      await load(img, url);
    } finally {
      if (before) URL.revokeObjectURL(before);
    }
  };
}

function load(img, url) {
  return new Promise((resolve, reject) => {
    img.onload = resolve;
    img.onerror = () => reject(new Error("cannot show a frame: it is not a JPEG"));
    img.src = url;
  });
}
