import assert from "node:assert/strict";
import { test } from "node:test";

import { drawnTopics } from "../../src/replay/mapOfDrive.js";

test("nothing of another robot is drawn, also where the robot has none of its own", () => {
  const scan = { name: "/robot1/scan", type: "sensor_msgs/msg/LaserScan" };
  const odometry = { name: "/robot2/odom", type: "nav_msgs/msg/Odometry" };
  const topics = [scan, { ...odometry, name: "/robot1/odom" }, odometry, { name: "/robot1/cmd_vel", type: "geometry_msgs/msg/Twist" }];
  const { scan: drawn, speed } = drawnTopics(topics, "/robot2/cmd_vel");
  assert.deepEqual([drawn, speed], [undefined, odometry]);
});
