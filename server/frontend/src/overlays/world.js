// What the map is drawn from: its subscriptions, which last only while it is seen, and what they say.

import { planar, poseReader } from "../client/rosbridge.js";
import { Subscriptions } from "./subscriptions.js";
import { Transforms, plainFrame, projected } from "./transforms.js";

const LIMITS = {
  scan: { throttleMs: 150 },
  // A map is large, and comes on the connection that the robot is driven by: one that is being made comes seldom.
  map: { throttleMs: 10_000 },
  located: { throttleMs: 200 },
  // Each publisher of /tf_static has a message of its own, and sends it once.
  tfStatic: { throttleMs: 0 },
  // Many publish on /tf, most of them in step with 10 Hz: a period that is not lets each of them be the next at times.
  tf: { throttleMs: 101, queueLength: 0 },
};
const [MAP_FRAME, ODOM_FRAME] = ["map", "odom"];
const BASE_FRAMES = ["base_link", "base_footprint"];
const OLD_MS = 1000;
const FRAMES_WITHIN_MS = 2000; // time limit for a robot's frames to say where its laser is
// A localization speaks as the robot moves, at least each half metre. One that the robot has left this far behind, in more time
// than this, no longer says where it is.
const SILENT_WAY_M = 2;
const SILENT_MS = 5000;
/** @type {(why: string) => void} */
const ignore = () => {};
const ORIGIN = { x: 0, y: 0, theta: 0 };

export class World {
  // `subscribe(spec, handler)` as of connection.js; `makeBitmap(grid)` gives a promise of what drawImage takes;
  // `onMapRefused(why)`: the server passes no map on.
  constructor({ subscribe, onChange, onMapRefused = ignore, makeBitmap = bitmapOf, now = () => performance.now() }) {
    this.subscriptions = new Subscriptions(subscribe);
    this.onChange = onChange;
    this.mapLimits = { ...LIMITS.map, onRefused: onMapRefused };
    this.makeBitmap = makeBitmap;
    this.now = now;
    this.path = new Path();
    this.topics = {};
    this.shown = null;
    this.ringShown = false;
    this.odometry = this.scan = this.map = this.located = null;
    this.mapUnread = false; // whether the robot's newest map could not be read
    this.offset = ORIGIN; // of the odometry's frame in the map's
    this.placed = false; // whether that is known
    this.placedAt = Infinity; // when the frames that say so came; never old where they come once
    this.left = /** @type {{x: number, y: number, at: number} | null} */ (null); // where a localization last found the robot, by its odometry
    this.transforms = new Transforms();
    this.laserFixed = false; // whether /tf_static alone says where the laser is
    this.scanSince = 0; // when the scan was subscribed to
  }

  // What was read is another robot's.
  forget() {
    for (const kind of Object.keys(LIMITS)) this.subscriptions.follow(kind, undefined);
    this.map?.bitmap.close?.();
    this.path.clear();
    this.odometry = this.scan = this.map = this.located = this.newestGrid = null;
    this.transforms = new Transforms();
    this.mapUnread = this.laserFixed = false;
    this.place(ORIGIN, {});
    this.placed = false;
  }

  // `topics` {scan, map, located, tf, tfStatic}, each {name, type} or undefined.
  follow(topics) {
    this.topics = topics;
    this.sync();
  }

  // `shown` {scan, map}, which of them are seen; null for nothing.
  show(shown) {
    this.shown = shown;
    this.sync();
  }

  // Whether the scan is seen beside the map, too.
  showRing(shown) {
    this.ringShown = shown;
    this.sync();
  }

  // The odometry's pose: comes with the speed, whether the map is seen or not. Null for unknown.
  receivePose(pose) {
    if (!pose) return;
    this.odometry = { pose, at: this.now() };
    this.locate();
    if (this.path.add(pose) || this.shown) this.onChange();
  }

  // Only what is seen and is there.
  sync() {
    const { topics, wanted } = this;
    const limits = { ...LIMITS, map: this.mapLimits };
    const follow = (kind, handler) => this.subscriptions.follow(kind, wanted[kind] ? topics[kind] : undefined, limits[kind], handler);
    if (follow("scan", (message) => this.receiveScan(message))) this.scanSince = this.now();
    follow("map", (message) => this.receiveMap(message));
    follow("located", (message) => this.receiveLocation(message));
    follow("tfStatic", (message) => this.receiveTransforms(message, true));
    follow("tf", (message) => this.receiveTransforms(message, false));
  }

  // Only the map needs to know where in it the robot is, and only a laser that moves needs more than /tf_static.
  get wanted() {
    const map = Boolean(this.shown?.map);
    const scan = Boolean(this.shown?.scan || this.ringShown);
    return { scan, map, located: map, tfStatic: scan || map, tf: map || (scan && !this.laserFixed) };
  }

  // A laser whose place the frames do not say is taken to be where the robot is; until they can have said it, nothing is drawn.
  receiveScan(message) {
    const points = scanPoints(message);
    const frame = message.header?.frame_id;
    const place = this.inBase(frame);
    if (!place && this.awaitsFrames) return;
    this.scan = { points: place ? projected(points, place) : points, at: this.now(), placed: Boolean(place), frame };
    const { laserFixed } = this;
    this.laserFixed = Boolean(place?.fixed);
    if (laserFixed !== this.laserFixed) this.sync();
    this.onChange();
  }

  receiveTransforms(message, fixed) {
    this.transforms.receive(message, { fixed, at: this.now() });
    if (this.scan && !this.scan.placed && this.inBase(this.scan.frame)) this.scan = null;
    this.locate();
    if (this.shown) this.onChange();
  }

  get awaitsFrames() {
    return Boolean(this.topics.tf || this.topics.tfStatic) && this.now() - this.scanSince < FRAMES_WITHIN_MS;
  }

  // Where the frame is in the robot's own, which its odometry names or has a usual name; null for unknown.
  inBase(frame) {
    for (const base of [this.odometry?.pose.base, ...BASE_FRAMES]) {
      const place = base && this.transforms.find(base, frame);
      if (place) return place;
    }
    return null;
  }

  // The frames tell where in the map the odometry began. Says whether they do.
  locate() {
    const frame = this.odometry?.pose.frame;
    const begun = frame && this.transforms.find(this.mapFrame, frame);
    const offset = begun && planarOf(begun);
    if (offset) this.place(offset, { at: begun.at });
    return Boolean(offset);
  }

  place(offset, { at = Infinity, left = null }) {
    this.offset = offset;
    this.placedAt = at;
    this.left = left;
    this.placed = true;
  }

  get mapFrame() {
    return this.map?.frame || MAP_FRAME;
  }

  // One that cannot be read leaves the one before, and says so.
  async receiveMap(message) {
    const grid = gridPixels(message);
    this.newestGrid = grid;
    const bitmap = grid && (await this.bitmapOf(grid));
    if (grid !== this.newestGrid) return bitmap?.close?.();
    this.mapUnread = !bitmap && !isEmptyMap(message);
    if (bitmap) this.useMap({ ...grid, frame: plainFrame(message.header?.frame_id), pixels: null, bitmap });
    this.onChange();
  }

  // Where the robot was in another frame is no place in this map.
  useMap(map) {
    const before = this.mapFrame;
    this.map?.bitmap.close?.();
    this.map = map;
    if (!this.locate() && this.mapFrame !== before) this.placed = false;
  }

  // Null where the browser makes none, as of one with too long a side.
  async bitmapOf(grid) {
    try {
      return await this.makeBitmap(grid);
    } catch {
      return null;
    }
  }

  // Where the localization says that the robot is tells where the odometry began, unless the frames do, which are newer. A filter
  // of the odometry speaks in the same type, and of no place in the map.
  receiveLocation(message) {
    const pose = poseReader(this.topics.located.type)?.(message);
    if (!pose || !["", this.mapFrame].includes(plainFrame(pose.frame))) return;
    this.located = pose;
    if (this.odometry && !this.locate()) {
      const left = { ...this.odometry.pose, at: this.now() };
      this.place(compose(pose, inverse(left)), { left });
    }
    this.onChange();
  }

  // The robot in the map's frame, {x, y, theta, old, unknown, unplaced}; `old` also where only the odometry goes on, `unknown`
  // while nothing is known of where it is, and `unplaced` while that is not where in the map.
  get robot() {
    if (this.odometry) {
      const old = this.isOld(this.odometry) || this.isOld({ at: this.placedAt }) || this.wasLeft(this.odometry.pose);
      return this.drawnAs({ ...compose(this.offset, this.odometry.pose), old }, this.placed);
    }
    const place = this.byFrames(this.mapFrame);
    const way = place ?? this.byFrames(ODOM_FRAME);
    if (way) return this.drawnAs({ ...planarOf(way), old: this.isOld(way) }, Boolean(place));
    return { ...(this.located ?? ORIGIN), old: true, unknown: !this.located };
  }

  wasLeft({ x, y }) {
    const { left } = this;
    return left !== null && this.now() - left.at > SILENT_MS && Math.hypot(x - left.x, y - left.y) > SILENT_WAY_M;
  }

  // `placed`: whether it is known where that is in the map.
  drawnAs(robot, placed) {
    return this.map && !placed ? { ...robot, unplaced: true } : robot;
  }

  // Where the robot is in a frame, by its frames alone; null for unknown.
  byFrames(target) {
    const places = BASE_FRAMES.map((base) => this.transforms.find(target, base));
    return places.find((place) => place && planarOf(place)) ?? null;
  }

  // The newest scan; an old one is none.
  get points() {
    return this.scan && !this.isOld(this.scan) ? this.scan.points : null;
  }

  // Whether there was one, and it says no more what is round the robot.
  get isScanSilent() {
    return this.scan !== null && this.points === null;
  }

  isOld({ at }) {
    return this.now() - at > OLD_MS;
  }
}

const planarOf = ({ translation, rotation }) => planar({ position: translation, orientation: rotation });

const bitmapOf = ({ pixels, width, height }) => createImageBitmap(new ImageData(pixels, width, height));

// The way that the robot came by its odometry, of bounded length. Pure.
const MAX_PATH_POINTS = 2000;
const STEP_M = 0.05;
const JUMP_M = 5;

export class Path {
  constructor() {
    this.points = [];
    this.step = STEP_M;
  }

  // Says whether the path has grown. A jump is a new beginning of the odometry and no way.
  add({ x, y }) {
    if (!Number.isFinite(x) || !Number.isFinite(y)) return false;
    const last = this.points.at(-1);
    const way = last ? Math.hypot(x - last.x, y - last.y) : Infinity;
    if (last && way > JUMP_M) this.clear();
    else if (way < this.step) return false;
    this.points.push({ x, y });
    if (this.points.length > MAX_PATH_POINTS) this.thin();
    return true;
  }

  // The whole way stays, in longer steps.
  thin() {
    this.points = this.points.filter((_, i) => i % 2 === 0);
    this.step *= 2;
  }

  clear() {
    this.points = [];
    this.step = STEP_M;
  }
}

// A sensor_msgs/LaserScan as points. Pure.
const MAX_SCAN_POINTS = 1500; // more than a screen shows, at 10 Hz

// Points in m in the scan's own frame, x and y in turn; what the sensor did not see (null, NaN, infinite, out of range)
// is left out.
export function scanPoints({ angle_min, angle_increment, range_min, range_max, ranges }) {
  if (![angle_min, angle_increment].every(Number.isFinite) || !Array.isArray(ranges)) return new Float32Array();
  const seen = within(range_min || 0, range_max > 0 ? range_max : Infinity);
  const step = Math.max(1, Math.ceil(ranges.length / MAX_SCAN_POINTS));
  const points = [];
  for (let i = 0; i < ranges.length; i += step) {
    if (!seen(ranges[i])) continue;
    const angle = angle_min + i * angle_increment;
    points.push(ranges[i] * Math.cos(angle), ranges[i] * Math.sin(angle));
  }
  return Float32Array.from(points);
}

const within = (least, most) => (range) => Number.isFinite(range) && range >= least && range <= most;

// A nav_msgs/OccupancyGrid as pixels. Pure.
const MAX_CELLS = 16_000_000;
const FREE = [58, 70, 86];
const OCCUPIED = [236, 240, 246];

// One colour for each value of a byte: 0 free to 100 occupied, any other unknown.
const COLOURS = new Uint32Array(256);
const bytes = new Uint8Array(COLOURS.buffer);
for (let value = 0; value <= 100; value++) {
  const mix = (channel) => FREE[channel] + ((OCCUPIED[channel] - FREE[channel]) * value) / 100;
  bytes.set([mix(0), mix(1), mix(2), 255], value * 4);
}

// Gives {width, height, pixels (RGBA, the first row is the map's lowest), resolution, origin {x, y, theta}}, or null for
// what is not a map, or lies nobody knows where. `data` is a list of numbers, or base64 as some bridges write bytes.
export function gridPixels({ info, data }) {
  const { width, height, resolution, origin } = info ?? {};
  const cells = cellsOf(data);
  const place = planar({ position: origin?.position, orientation: turnOf(origin) });
  if (!place || !fits(width, height, resolution) || cells.length !== width * height) return null;
  const pixels = new Uint32Array(cells.length);
  // Unknown is, too, what is no byte: of 256 the lowest bits say free.
  for (let i = 0; i < cells.length; i++) if (cells[i] === (cells[i] & 255)) pixels[i] = COLOURS[cells[i]];
  return { width, height, resolution, pixels: new Uint8ClampedArray(pixels.buffer), origin: place };
}

// Of a robot that has begun to map, and has seen nothing yet.
const isEmptyMap = ({ info }) => info?.width === 0 || info?.height === 0;

// Map servers leave the orientation of a map that is not turned as it is: all zeros.
function turnOf(origin) {
  const orientation = origin?.orientation ?? UNSET;
  return Object.values(orientation).every((part) => part === 0) ? { ...UNSET, w: 1 } : orientation;
}
const UNSET = { x: 0, y: 0, z: 0, w: 0 };

const fits = (width, height, resolution) =>
  [width, height].every((side) => Number.isInteger(side) && side > 0) &&
  width * height <= MAX_CELLS &&
  resolution > 0 &&
  resolution < Infinity;

const cellsOf = (data) => (typeof data === "string" ? signedBytes(data) : (data ?? []));

function signedBytes(base64) {
  try {
    return Int8Array.from(atob(base64), (char) => char.charCodeAt(0));
  } catch {
    return [];
  }
}

// Where `pose`, which is given in the frame of `frame`, is in the frame that `frame` is given in.
function compose(frame, { x, y, theta }) {
  const [cos, sin] = [Math.cos(frame.theta), Math.sin(frame.theta)];
  return { x: frame.x + x * cos - y * sin, y: frame.y + x * sin + y * cos, theta: frame.theta + theta };
}

function inverse({ x, y, theta }) {
  const [cos, sin] = [Math.cos(theta), Math.sin(theta)];
  return { x: -x * cos - y * sin, y: x * sin - y * cos, theta: -theta };
}
