import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { planar, poseReader } from "../../src/client/rosbridge.js";
import { gridPixels, Path, scanPoints, World } from "../../src/overlays/world.js";

const SCAN = { name: "/scan", type: "sensor_msgs/LaserScan" };
const MAP = { name: "/map", type: "nav_msgs/OccupancyGrid" };
const PLACE = { name: "/amcl_pose", type: "geometry_msgs/PoseWithCovarianceStamped" };
const TF = { name: "/tf", type: "tf2_msgs/TFMessage" };
const TF_STATIC = { name: "/tf_static", type: "tf2_msgs/TFMessage" };
const scan = { header: { frame_id: "laser" }, angle_min: 0, angle_increment: 1, range_min: 0, range_max: 9, ranges: [1] };
const AHEAD = { x: 0, y: 0, z: 0, w: 1 };
const at = (x, y) => ({ position: { x, y, z: 0 }, orientation: AHEAD });
const grid = (value) => ({ info: { width: 1, height: 1, resolution: 1, origin: at(0, 0) }, data: [value] });

const LEFT = { x: 0, y: 0, z: Math.SQRT1_2, w: Math.SQRT1_2 };
const link = (parent, child, x, rotation = LEFT) => ({
  header: { frame_id: parent },
  child_frame_id: child,
  transform: { translation: { x, y: 0, z: 0 }, rotation },
});
const tf = (...transforms) => ({ transforms });
const rounded = (values) => [...values].map((value) => Math.round(value * 1000) / 1000 + 0);

let clock, handlers, closed, world, changes, refused;

beforeEach(() => {
  clock = 0;
  changes = 0;
  handlers = new Map();
  closed = [];
  refused = [];
  world = new World({
    subscribe: ({ name, onRefused }, handler) => {
      handlers.set(name, handler);
      onRefused?.(`cannot subscribe to ${name}: it is too large`);
      return () => handlers.delete(name);
    },
    onChange: () => (changes += 1),
    onMapRefused: (why) => refused.push(why),
    makeBitmap: async (made) => ({ of: made, close: () => closed.push(made) }),
    now: () => clock,
  });
});

const ALL = { scan: SCAN, map: MAP, located: PLACE, tf: TF, tfStatic: TF_STATIC };
const BOTH = { scan: true, map: true };
const follow = (topics) => world.follow(topics);
const show = (parts) => world.show(parts);
const ring = (shown) => world.showRing(shown);
const say = (topic, message) => handlers.get(topic)(message);
const fix = () => say("/tf_static", tf(link("base_link", "laser", 0)));

const sayMap = (frame_id) => say("/map", { header: { frame_id }, ...grid(0) });
const sayFrames = (parent, child) => say("/tf", tf(link(parent, child, 2)));

function seeMap(topics = {}) {
  follow({ map: MAP, ...topics });
  show({ map: true });
}

const LASER = { scan: SCAN, map: MAP };
const ringOnAll = () => [follow(ALL), ring(true)];

// What is subscribed to after some steps: only what is seen, and the frames that it needs.
for (const [name, act, topics] of [
  ["nothing while nothing is seen", () => follow(ALL), ""],
  ["a scan alone", () => [follow(LASER), show({ scan: true, map: false })], "scan"],
  ["the map with the localization", () => [follow({ map: MAP, located: PLACE }), show(BOTH)], "amcl_pose map"],
  ["nothing any more", () => [follow(ALL), show(BOTH), show(null)], ""],
  ["the scan round the stick, without the map too", () => [follow(LASER), ring(true), show(BOTH), show(null)], "scan"],
  ["no scan when the ring goes", () => [follow(LASER), ring(true), ring(false)], ""],
  ["a topic by its new name", () => [show(BOTH), follow(LASER), follow({ scan: { ...SCAN, name: "/front" } })], "front"],
  ["moving frames for a laser that may move", () => [ringOnAll(), say("/scan", scan)], "scan tf tf_static"],
  ["none for one that is fixed", () => [ringOnAll(), fix(), say("/scan", scan)], "scan tf_static"],
  ["except the map", () => [ringOnAll(), fix(), say("/scan", scan), show({ map: true })], "amcl_pose map scan tf tf_static"],
]) {
  test(`what is subscribed to: ${name}`, () => {
    act();
    const names = [...handlers.keys()].map((topic) => topic.slice(1));
    assert.equal(names.sort().join(" "), topics);
  });
}

test("what another robot said is forgotten, and the topics that stay are subscribed to anew", async () => {
  follow(ALL);
  show(BOTH);
  world.receivePose({ x: 1, y: 2, theta: 0 });
  say("/scan", scan);
  await say("/map", grid(0));
  const late = say("/map", grid(100));
  world.forget();
  assert.equal(handlers.size, 0);
  follow(ALL);
  await late;
  assert.deepEqual([world.map, world.points, world.robot.unknown, world.path.points, closed.length], [null, null, true, [], 2]);
  assert.ok(handlers.has("/map"));
});

test("why the server passes no map on is said", () => {
  follow(ALL);
  show(BOTH);
  assert.deepEqual(refused, ["cannot subscribe to /map: it is too large"]);
});

test("a scan that is old is shown no more", () => {
  world.follow({ scan: SCAN });
  world.show({ scan: true });
  assert.equal(world.isScanSilent, false);
  say("/scan", scan);
  assert.equal(world.points.length, 2);
  assert.equal(world.isScanSilent, false);
  clock = 1001;
  assert.deepEqual([world.points, world.isScanSilent], [null, true]);
});

test("the robot is where its odometry says, and old when that is silent", () => {
  assert.deepEqual(world.robot, { x: 0, y: 0, theta: 0, old: true, unknown: true });
  world.receivePose(null);
  assert.equal(world.robot.unknown, true);
  world.receivePose({ x: 1, y: 2, theta: 0 });
  assert.deepEqual(world.robot, { x: 1, y: 2, theta: 0, old: false });
  clock = 1001;
  assert.equal(world.robot.old, true);
});

const turnWheels = () => world.receivePose({ x: 1, y: 0, theta: 0, frame: "odom" });

// Whether the robot has no place in the map after each of some steps.
for (const [name, steps, unplaced] of [
  ["odometry alone is none", [turnWheels, () => sayMap("map"), () => sayFrames("map", "odom")], [false, true, false]],
  [
    "one in a map is none in the next, which has another frame",
    [turnWheels, () => sayFrames("floor1", "odom"), () => sayMap("floor1"), () => sayMap("floor2")],
    [false, false, false, true],
  ],
  ["by the wheels' frame alone there is none", [() => sayMap("map"), () => sayFrames("odom", "base_link")], [false, true]],
  ["by the map's frame there is one", [() => sayMap("map"), () => sayFrames("map", "base_link")], [false, false]],
]) {
  test(`a place in a map: ${name}`, async () => {
    seeMap({ tf: TF });
    const found = [];
    for (const step of steps) {
      await step();
      found.push(Boolean(world.robot.unplaced));
    }
    assert.deepEqual(found, unplaced);
  });
}

test("the localization moves the odometry's frame, and the way with it", () => {
  seeMap({ located: PLACE });
  world.receivePose({ x: 1, y: 0, theta: 0 });
  say("/amcl_pose", { pose: { pose: at(5, 5) } });
  world.receivePose({ x: 2, y: 0, theta: 0 });
  assert.deepEqual([world.robot.x, world.robot.y], [6, 5]);
});

test("the place of a robot that has left its localization behind is old, and of one that stands is not", () => {
  seeMap({ located: PLACE });
  world.receivePose({ x: 1, y: 0, theta: 0 });
  say("/amcl_pose", { pose: { pose: at(5, 5) } });
  const old = [];
  for (const [ms, x] of [
    [4000, 4],
    [6000, 1],
    [7000, 4],
  ]) {
    clock = ms;
    world.receivePose({ x, y: 0, theta: 0 });
    old.push(world.robot.old);
  }
  say("/amcl_pose", { pose: { pose: at(8, 5) } });
  assert.deepEqual([...old, world.robot.old], [false, false, true, false]);
});

test("a newer map takes the place of the one before, whose bitmap is closed", async () => {
  seeMap();
  await say("/map", grid(0));
  const first = world.map;
  await say("/map", grid(100));
  assert.notEqual(world.map, first);
  assert.deepEqual([closed.length, world.map.pixels], [1, null]);
  await say("/map", { info: {}, data: [] });
  assert.equal(world.map.bitmap.of.width, 1);
});

test("a map that cannot be read is said, until one can", async () => {
  seeMap();
  const unread = [];
  for (const message of [{ info: { width: 0, height: 0 }, data: [] }, grid(0), { ...grid(0), data: "***" }, grid(100), "too long"]) {
    world.makeBitmap = message === "too long" ? () => Promise.reject(new Error("no memory")) : async () => ({});
    await say("/map", message === "too long" ? grid(0) : message);
    unread.push(world.mapUnread);
  }
  assert.deepEqual(unread, [false, false, true, false, true]);
});

test("a scan is where the laser is on the robot, which the odometry names or is called as usual", () => {
  for (const base of [undefined, "rover/base"]) {
    world.receivePose({ x: 0, y: 0, theta: 0, frame: "odom", base });
    world.follow({ scan: SCAN, tfStatic: TF_STATIC });
    world.show({ scan: true });
    if (!base) {
      say("/scan", scan);
      assert.equal(world.points, null, "while the frames may be on their way");
      clock = 2000;
    }
    say("/scan", { ...scan, header: { frame_id: base ? "rover/laser" : "laser" } });
    assert.deepEqual(rounded(world.points), [1, 0], "when they say nothing of it");
    say("/tf_static", tf(link(base ?? "base_link", base ? "rover/laser" : "laser", 0.5)));
    assert.equal(world.points, null, "once they say it, what was drawn without them goes");
    say("/scan", { ...scan, header: { frame_id: base ? "/rover/laser" : "/laser" } });
    assert.deepEqual(rounded(world.points), [0.5, 1]);
  }
});

test("the frames say where the odometry began, in whatever frame the map is, and the localization then no more", async () => {
  seeMap({ located: PLACE, tf: TF });
  await sayMap("/site");
  world.receivePose({ x: 1, y: 2, theta: 0, frame: "odom", base: "base_link" });
  say("/tf", tf(link("site", "odom", 3)));
  say("/amcl_pose", { pose: { pose: at(9, 9) } });
  const { x, y, theta, old } = world.robot;
  assert.deepEqual([rounded([x, y]), old], [[1, 1], false]);
  assert.ok(Math.abs(theta - Math.PI / 2) < 1e-9);
  clock = 1001;
  world.receivePose({ x: 1, y: 2, theta: 0, frame: "odom", base: "base_link" });
  assert.equal(world.robot.old, true, "the frames are silent, the odometry is not");
});

test("a robot without odometry is where its frames say, and old when they are silent", () => {
  seeMap({ tf: TF });
  for (const parent of ["odom", "map"]) {
    say("/tf", tf(link(parent, "base_link", 2)));
    assert.deepEqual([world.robot.x, world.robot.old], [2, false]);
  }
  clock = 1001;
  assert.equal(world.robot.old, true);
});

test("a pose in another frame than the map's says nothing of a place in it", () => {
  seeMap({ located: PLACE });
  world.receivePose({ x: 1, y: 0, theta: 0 });
  const places = [];
  for (const frame_id of ["odom_combined", "/map"]) {
    say("/amcl_pose", { header: { frame_id }, pose: { pose: at(5, 5) } });
    places.push([world.placed, world.robot.x]);
  }
  assert.deepEqual(places, [
    [false, 1],
    [true, 5],
  ]);
});

const info = { width: 2, height: 2, resolution: 0.5, origin: { position: { x: -1, y: 2, z: 0 }, orientation: { x: 0, y: 0, z: 1, w: 0 } } };

test("what is no number from 0 to 100 is no free cell", () => {
  const data = [null, NaN, "0", Infinity, 256, -256, 2 ** 32, 101];
  assert.ok(gridPixels({ info: { ...info, width: 4 }, data }).pixels.every((value) => value === 0));
});

test("bytes in base64 are the same map", () => {
  const data = btoa(String.fromCharCode(0, 100, 255, 50));
  assert.deepEqual(gridPixels({ info, data }).pixels, gridPixels({ info, data: [0, 100, -1, 50] }).pixels);
});

test("what does not fit together is no map", () => {
  for (const changes of [{ resolution: 0 }, { resolution: Infinity }, { width: 1.6, height: 2.5 }, { width: 1e6, height: 1e6 }]) {
    assert.equal(gridPixels({ info: { ...info, ...changes }, data: [0, 0, 0, 0] }), null);
  }
  for (const data of [[0], "***"]) assert.equal(gridPixels({ info, data }), null);
  assert.equal(gridPixels({}), null);
});

test("a map that is not turned may leave its orientation unset, but not its place", () => {
  const originOf = (origin) => gridPixels({ info: { ...info, origin }, data: [0, 0, 0, 0] })?.origin;
  const { position } = info.origin;
  assert.deepEqual(originOf({ position, orientation: { x: 0, y: 0, z: 0, w: 0 } }), { x: -1, y: 2, theta: 0 });
  assert.deepEqual(originOf(null), undefined);
  assert.deepEqual(originOf({ position: { ...position, x: null } }), undefined);
  assert.deepEqual(originOf({ position, orientation: { x: null, y: null, z: null, w: null } }), undefined);
});

test("a pose without place or heading is unknown", () => {
  const { position, orientation } = info.origin;
  assert.notEqual(planar({ position, orientation }), null);
  for (const changes of [
    { w: 0, z: 0 },
    { w: 1, z: null },
  ])
    assert.equal(planar({ position, orientation: { ...orientation, ...changes } }), null);
  for (const pose of [undefined, null, { position: { ...position, y: null }, orientation }]) assert.equal(planar(pose), null);
});

test("a robot that stands adds nothing to its path, and odometry that begins anew begins a new one", () => {
  const path = new Path();
  const added = [0, 0.01, 0.2, NaN].map((x) => path.add({ x, y: 0 }));
  assert.deepEqual(added, [true, false, true, false]);
  path.add({ x: 40, y: 0 });
  assert.deepEqual(path.points, [{ x: 40, y: 0 }]);
});

test("a day's way keeps its beginning and its end in bounded room", () => {
  const path = new Path();
  for (let i = 0; i <= 50_000; i++) path.add({ x: i / 10, y: 0 });
  assert.ok(path.points.length <= 2000);
  assert.equal(path.points[0].x, 0);
  assert.ok(5000 - path.points.at(-1).x < 5);
});

const near = (a, b) => ["x", "y", "theta"].forEach((key) => assert.ok(Math.abs(a[key] - b[key]) < 1e-9, `${key}: ${a[key]}`));

test("odometry, localization and turtlesim tell poses, a twist does not", () => {
  const pose = { position: { x: 1, y: 2, z: 0 }, orientation: { x: 0, y: 0, z: Math.SQRT1_2, w: Math.SQRT1_2 } };
  const expected = { x: 1, y: 2, theta: Math.PI / 2 };
  const odometry = { header: { frame_id: "odom" }, child_frame_id: "base_link", pose: { pose } };
  const { frame, base, ...read } = poseReader("nav_msgs/msg/Odometry")(odometry);
  assert.deepEqual([frame, base], ["odom", "base_link"]);
  near(read, expected);
  near(poseReader("geometry_msgs/PoseWithCovarianceStamped")({ pose: { pose } }), expected);
  near(poseReader("turtlesim/msg/Pose")(expected), expected);
  assert.equal(poseReader("geometry_msgs/Twist"), undefined);
});

const quarters = { angle_min: -Math.PI / 2, angle_increment: Math.PI / 2, range_min: 0.1, range_max: 10, ranges: [1, 2, 3] };

for (const [what, changes, count] of [
  ["what the sensor did not see is left out", { ranges: [null, NaN, Infinity, 0.05, 11, 2] }, 1],
  ["without a range limit all that is a number is shown", { range_max: 0 }, 3],
  ["a very fine scan is thinned out", { ranges: new Array(40_000).fill(1) }, 1482],
]) {
  test(`a scan: ${what}`, () => assert.equal(scanPoints({ ...quarters, ...changes }).length / 2, count));
}

test("ranges become points around the sensor, x ahead and y to the left", () => {
  assert.deepEqual(rounded(scanPoints(quarters)), [0, -1, 2, 0, 0, 3]);
});
