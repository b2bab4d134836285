import assert from "node:assert/strict";
import { test } from "node:test";

import {
  imageTopics,
  speedReader,
  speedTopic,
  twistMessage,
  twistType,
} from "../src/messages.js";

test("what the robot says of cmd_vel decides the type", () => {
  assert.equal(twistType("geometry_msgs/Twist", ["std_msgs/msg/String"]), "geometry_msgs/Twist");
  assert.equal(twistType("geometry_msgs/msg/Twist", []), "geometry_msgs/msg/Twist");
  assert.equal(twistType("geometry_msgs/msg/TwistStamped", []), "geometry_msgs/msg/TwistStamped");
});

test("without an answer the other types decide, and without any the ROS 1 name is taken", () => {
  assert.equal(twistType("", ["nav_msgs/msg/Odometry"]), "geometry_msgs/msg/Twist");
  assert.equal(twistType("", ["nav_msgs/Odometry"]), "geometry_msgs/Twist");
  assert.equal(twistType("", []), "geometry_msgs/Twist");
  assert.equal(twistType("std_msgs/String", []), "geometry_msgs/Twist");
});

test("a stamped type gets the same twist in an envelope", () => {
  const speed = { forward: 1, turn: 2 };
  const twist = { linear: { x: 1, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 2 } };
  assert.deepEqual(twistMessage("geometry_msgs/msg/Twist", speed), twist);
  assert.deepEqual(twistMessage("geometry_msgs/msg/TwistStamped", speed).twist, twist);
});

test("odometry comes before pose, and the usual name before others, in either ROS", () => {
  const topics = [
    { name: "/turtle1/pose", type: "turtlesim/Pose" },
    { name: "/pose", type: "turtlesim/msg/Pose" },
    { name: "/base/odom", type: "nav_msgs/msg/Odometry" },
    { name: "/odom", type: "nav_msgs/msg/Odometry" },
    { name: "/cmd_vel", type: "geometry_msgs/Twist" },
  ];
  assert.equal(speedTopic(topics).name, "/odom");
  assert.equal(speedTopic(topics.slice(0, 3)).name, "/base/odom");
  assert.equal(speedTopic(topics.slice(0, 2)).name, "/pose");
  assert.equal(speedTopic(topics.slice(4)), undefined);
});

test("speed is read from odometry and from turtlesim's pose", () => {
  const odometry = { twist: { twist: { linear: { x: 0.5 }, angular: { z: -1 } } } };
  assert.deepEqual(speedReader("nav_msgs/Odometry")(odometry), { forward: 0.5, turn: -1 });
  const pose = { linear_velocity: 0.5, angular_velocity: -1 };
  assert.deepEqual(speedReader("turtlesim/msg/Pose")(pose), { forward: 0.5, turn: -1 });
});

test("only raw images are offered as cameras", () => {
  const topics = [
    { name: "/rear", type: "sensor_msgs/msg/Image" },
    { name: "/front", type: "sensor_msgs/Image" },
    { name: "/scan", type: "sensor_msgs/LaserScan" },
  ];
  assert.deepEqual(imageTopics(topics), ["/front", "/rear"]);
});
