import assert from "node:assert/strict";
import { test } from "node:test";

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
