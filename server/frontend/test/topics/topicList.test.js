import assert from "node:assert/strict";
import { test } from "node:test";

import { places } from "../../src/topics/inspector.js";
import { matching } from "../../src/topics/topicList.js";

test("topics are found by words of their name or type, in order", () => {
  const topics = [
    { name: "/scan", type: "sensor_msgs/LaserScan" },
    { name: "/odom", type: "nav_msgs/Odometry" },
    { name: "/imu", type: "sensor_msgs/Imu" },
  ];
  const names = (query) => matching(topics, query).map(({ name }) => name);
  assert.deepEqual(names(""), ["/imu", "/odom", "/scan"]);
  assert.deepEqual(names("SENSOR"), ["/imu", "/scan"]);
  assert.deepEqual(names("sensor scan"), ["/scan"]);
  assert.deepEqual(names("lidar"), []);
});

test("a plot has the newest at the right and the greatest on top", () => {
  const points = [
    { value: 0, at: 0 },
    { value: 10, at: 60_000 },
  ];
  const size = { width: 100, height: 58 };
  assert.deepEqual(places(points, { now: 60_000, min: 0, max: 10 }, size), [
    { x: 0, y: 54 },
    { x: 100, y: 4 },
  ]);
  assert.deepEqual(places([{ value: 3, at: 0 }], { now: 0, min: 3, max: 3 }, size), [{ x: 100, y: 29 }]);
});
