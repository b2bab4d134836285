import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { World } from "../../src/overlays/world.js";

const SCAN = { name: "/scan", type: "sensor_msgs/LaserScan" };
const MAP = { name: "/map", type: "nav_msgs/OccupancyGrid" };
const PLACE = { name: "/amcl_pose", type: "geometry_msgs/PoseWithCovarianceStamped" };
const scan = { angle_min: 0, angle_increment: 1, range_min: 0, range_max: 9, ranges: [1] };
const grid = (value) => ({ info: { width: 1, height: 1, resolution: 1 }, data: [value] });

let clock, handlers, closed, world, changes;

beforeEach(() => {
  clock = 0;
  changes = 0;
  handlers = new Map();
  closed = [];
  world = new World({
    subscribe: ({ name }, handler) => {
      handlers.set(name, handler);
      return () => handlers.delete(name);
    },
    onChange: () => (changes += 1),
    makeBitmap: async (made) => ({ of: made, close: () => closed.push(made) }),
    now: () => clock,
  });
});

test("only what is seen is subscribed to", () => {
  world.follow({ scan: SCAN, map: MAP, located: PLACE });
  assert.equal(handlers.size, 0);
  world.show({ scan: true, map: false });
  assert.deepEqual([...handlers.keys()], ["/scan"]);
  world.show({ scan: true, map: true });
  assert.deepEqual([...handlers.keys()].sort(), ["/amcl_pose", "/map", "/scan"]);
  world.show(null);
  assert.equal(handlers.size, 0);
});

test("a scan that is seen round the stick comes with the map and without it", () => {
  world.follow({ scan: SCAN, map: MAP });
  world.showRing(true);
  world.show({ scan: true, map: true });
  world.show(null);
  assert.deepEqual([...handlers.keys()], ["/scan"]);
  world.showRing(false);
  assert.equal(handlers.size, 0);
});

test("a topic that changes its name is followed to the new one", () => {
  world.show({ scan: true, map: true });
  world.follow({ scan: SCAN });
  world.follow({ scan: { ...SCAN, name: "/front/scan" } });
  assert.deepEqual([...handlers.keys()], ["/front/scan"]);
});

test("a scan that is old is shown no more", () => {
  world.follow({ scan: SCAN });
  world.show({ scan: true });
  handlers.get("/scan")(scan);
  assert.equal(world.points.length, 2);
  clock = 1001;
  assert.equal(world.points, null);
});

test("the robot is where its odometry says, and old when that is silent", () => {
  assert.deepEqual(world.robot, { x: 0, y: 0, theta: 0, old: true });
  world.receivePose({ x: 1, y: 2, theta: 0 });
  assert.deepEqual(world.robot, { x: 1, y: 2, theta: 0, old: false });
  clock = 1001;
  assert.equal(world.robot.old, true);
});

test("the localization moves the odometry's frame, and the way with it", () => {
  world.follow({ map: MAP, located: PLACE });
  world.show({ map: true });
  world.receivePose({ x: 1, y: 0, theta: 0 });
  handlers.get("/amcl_pose")({ pose: { pose: { position: { x: 5, y: 5, z: 0 } } } });
  world.receivePose({ x: 2, y: 0, theta: 0 });
  assert.deepEqual([world.robot.x, world.robot.y], [6, 5]);
});

test("a newer map takes the place of the one before, whose picture is given back", async () => {
  world.follow({ map: MAP });
  world.show({ map: true });
  await handlers.get("/map")(grid(0));
  const first = world.map;
  await handlers.get("/map")(grid(100));
  assert.notEqual(world.map, first);
  assert.deepEqual([closed.length, world.map.pixels], [1, null]);
  await handlers.get("/map")({ info: {}, data: [] });
  assert.equal(world.map.bitmap.of.width, 1);
});
