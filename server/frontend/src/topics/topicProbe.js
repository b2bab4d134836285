// A probe of one topic: what was received of it, and how often. Pure except for its timer.
// It asks for two messages a second at most, and for one when the person says so where these are large, by their type or as they came.

import { CONNECTING, Connection, TOO_BIG } from "../client/connection.js";
import { openLink, plainType } from "../client/rosbridge.js";
import { numberAt, numbersIn } from "./fields.js";

const THROTTLE_MS = 500;
const MAX_FOLLOWED_LENGTH = 1024 * 1024; // of a message as JSON: a longer one stops the page, which also drives, for a while
export const MEASURE_MS = 3000;

export class TopicProbe {
  // `topic` is {name, type}; `watch(spec, onMessage, onState)` as of ObserverConnection.
  constructor({ topic, watch, onChange = () => {}, now = () => performance.now() }) {
    this.topic = topic;
    this.watch = watch;
    this.onChange = onChange;
    this.now = now;
    this.large = isLargeType(topic.type);
    this.message = null;
    this.unread = false; // whether the newest message could not be read
    this.size = 0;
    this.numbers = numbersIn(null);
    this.field = "";
    this.samples = new LastMinute();
    this.rate = new Rate();
    this.state = "idle"; // "lost", "open", "too_big", "refused"
    this.refusal = "";
    this.measured = /** @type {{perSecond: number, at: number} | null} */ (null);
    this.ends = new Set();
    if (!this.large) this.follow();
  }

  follow() {
    this.begin({ throttleMs: THROTTLE_MS }, (message) => this.receive(message));
  }

  // One message of a large type, and no second: the throttle keeps the robot from sending more meanwhile. It can be asked for anew
  // after a refusal, too.
  getOne() {
    if (this.ends.size > 0) return;
    const end = this.begin(
      { throttleMs: 60_000 },
      (message) => {
        end();
        this.receive(message);
      },
      () => end(),
    );
  }

  stopFollowing() {
    this.large = true;
    this.measuring = false;
    this.numbers = numbersIn(null);
    this.end();
  }

  // Every message for a while: a throttled topic does not show its rate.
  measure() {
    if (this.measuring || this.state !== "open") return;
    let count = 0;
    const began = this.now();
    this.measuring = true;
    const end = this.begin({ throttleMs: 0 }, () => (count += 1));
    this.timer = setTimeout(() => {
      end();
      this.measuring = false;
      // Of the time that it took: a page that nobody looks at has late timers.
      const at = this.now();
      this.measured = { perSecond: (1000 * count) / (at - began), at };
      this.onChange();
    }, MEASURE_MS);
    this.onChange();
  }

  begin(how, onMessage, onFail = () => {}) {
    const onUnread = () => {
      onFail();
      this.unread = true;
      this.onChange();
    };
    const onRefused = (why) => {
      onFail();
      this.refuse(why);
    };
    const spec = { ...this.topic, ...how, onRefused, onUnread };
    const end = this.watch(spec, onMessage, (state) => this.show(state));
    const ends = () => {
      this.ends.delete(ends);
      end();
    };
    this.ends.add(ends);
    return ends;
  }

  show(state) {
    if (this.state !== "refused") this.change(state);
  }

  refuse(why) {
    this.refusal = why;
    this.change("refused");
  }

  // What nothing came of is a gap of the plot, and its silence is not the topic's.
  change(state) {
    this.state = state;
    if (state !== "open") {
      this.samples.push(NaN, this.now());
      this.rate = new Rate();
    }
    this.onChange();
  }

  receive(message) {
    const at = this.now();
    this.message = message;
    if (this.state === "refused") this.state = "open"; // what the server could not pass on comes again
    this.unread = false;
    this.rate.mark(at);
    this.size = JSON.stringify(message).length;
    if (this.size > MAX_FOLLOWED_LENGTH && !this.large) this.stopFollowing();
    if (!this.large) this.numbers = numbersIn(message);
    if (this.field) this.samples.push(numberAt(message, this.field), at);
    this.onChange();
  }

  plot(field) {
    if (field === this.field) return;
    this.field = field;
    this.samples = new LastMinute();
    if (field && this.rate.at !== null) this.samples.push(numberAt(this.message, field), this.rate.at);
    this.onChange();
  }

  // {kind: "none"|"measuring"|"measured"|"slow"|"least"|"rate", perSecond, seconds}
  get pace() {
    if (this.measuring) return { kind: "measuring" };
    if (this.large) return { kind: "none" };
    const silence = this.rate.silenceMs(this.now());
    if (silence !== null && silence > 5000) return { kind: "slow", seconds: Math.round(silence / 1000) };
    const { measured } = this;
    if (!measured) return this.throttledPace();
    return { kind: "measured", perSecond: measured.perSecond, seconds: Math.round((this.now() - measured.at) / 1000) };
  }

  throttledPace() {
    const perSecond = this.rate.perSecond(this.now());
    if (perSecond === null) return { kind: "none" };
    return { kind: perSecond > 850 / THROTTLE_MS ? "least" : "rate", perSecond };
  }

  end() {
    clearTimeout(this.timer);
    for (const end of [...this.ends]) end();
  }
}

// Which types of messages are too large to be asked for again and again. Pure.
const LARGE_TYPES = {
  sensor_msgs: ["Image", "CompressedImage", "PointCloud", "PointCloud2"],
  nav_msgs: ["OccupancyGrid", "GetMap"],
  nav2_msgs: ["VoxelGrid", "Costmap"],
  octomap_msgs: ["Octomap", "OctomapWithPose"],
  costmap_2d: ["VoxelGrid"],
  grid_map_msgs: ["GridMap"],
  stereo_msgs: ["DisparityImage"],
  visualization_msgs: ["MarkerArray"],
  shape_msgs: ["Mesh"],
  audio_common_msgs: ["AudioData"],
  theora_image_transport: ["Packet"],
  ffmpeg_image_transport_msgs: ["FFMPEGPacket"],
  foxglove_msgs: ["CompressedVideo"],
};

function isLargeType(type) {
  const [pack, name] = plainType(type || "").split("/");
  return Boolean(LARGE_TYPES[pack]?.includes(name));
}

// What is kept of a topic: the numbers of the last minute, and how often messages come. Pure.
const MINUTE_MS = 60_000;
const MAX_POINTS = 600;
const RATE_MS = 10_000;

export class LastMinute {
  constructor() {
    this.points = [];
  }

  // What is not a finite number is a gap, {value: null}.
  push(value, at) {
    this.points.push({ value: Number.isFinite(value) ? value : null, at });
    if (this.points.length > MAX_POINTS) this.points.shift();
    this.prune(at);
  }

  prune(now) {
    while (this.points.length && now - this.points[0].at > MINUTE_MS) this.points.shift();
  }

  // {now, min, max}, or null without a value; `now` is null while the newest is a gap.
  extent(now) {
    this.prune(now);
    const values = this.points.map(({ value }) => value).filter((value) => value !== null);
    if (values.length === 0) return null;
    return { now: this.points.at(-1).value, min: Math.min(...values), max: Math.max(...values) };
  }
}

class Rate {
  constructor() {
    this.times = [];
    this.at = null;
  }

  mark(at) {
    this.at = at;
    this.times.push(at);
    while (at - this.times[0] > RATE_MS) this.times.shift();
  }

  // Messages a second, of those that came in the last 10 s; null before there are two.
  perSecond(now) {
    const recent = this.times.filter((at) => now - at <= RATE_MS);
    const span = recent.at(-1) - recent[0];
    return span > 0 ? (1000 * (recent.length - 1)) / span : null;
  }

  silenceMs(now) {
    return this.at === null ? null : now - this.at;
  }
}

// A connection of its own that only watches: a message that is too large for the server ends the connection it comes on, and
// that must not be the one that drives. Open only while a probe is open.

export class ObserverConnection {
  // `requestUrl()` gives a URL.
  constructor({ requestUrl, open = openLink }) {
    this.watchers = new Set();
    this.wanted = false;
    this.connection = new Connection({
      requestTicket: requestUrl,
      openLink: open,
      onState: (state) => this.receive(state),
      maxSilenceMs: Infinity, // a topic may well be silent
    });
  }

  // Whether the server counts it among those that watch the robot.
  get live() {
    return this.connection.live;
  }

  // Whether there is a way to the robot: the page's own connection stands, and the page is seen.
  use(wanted) {
    this.wanted = wanted;
    this.renew();
  }

  // `spec` as of rosbridge.js; `onState("lost"|"open"|"too_big")`. Gives the function that ends it.
  watch(spec, onMessage, onState) {
    const watcher = { onState, end: this.connection.subscribe(spec, onMessage) };
    this.watchers.add(watcher);
    if (this.connection.live) onState("open");
    this.renew();
    return () => this.leave(watcher);
  }

  leave(watcher) {
    watcher.end();
    this.watchers.delete(watcher);
    this.renew();
  }

  // Opens what is wanted and closes what is not.
  renew() {
    const wanted = this.wanted && this.watchers.size > 0;
    if (wanted && !this.connection.started) this.connection.start();
    if (wanted || !this.connection.started) return;
    this.connection.stop();
    this.notify("lost");
  }

  receive(state) {
    if (state.name === "live") this.notify("open");
    else if (state !== CONNECTING) this.lose(state.code === TOO_BIG ? "too_big" : "lost");
  }

  // What was too large once is not asked for again.
  lose(how) {
    this.notify(how);
    if (how === "too_big") for (const watcher of [...this.watchers]) this.leave(watcher);
  }

  notify(state) {
    for (const { onState } of [...this.watchers]) onState(state);
  }
}
