import assert from "node:assert/strict";
import { test } from "node:test";

import { poseReader } from "../../src/client/rosbridge.js";
import { compose, inverse } from "../../src/overlays/world.js";

const near = (a, b) => ["x", "y", "theta"].forEach((key) => assert.ok(Math.abs(a[key] - b[key]) < 1e-9, `${key}: ${a[key]}`));

test("a pose in a frame that is turned left lies to the left", () => {
  near(compose({ x: 1, y: 2, theta: Math.PI / 2 }, { x: 3, y: 0, theta: 0 }), { x: 1, y: 5, theta: Math.PI / 2 });
});

const HERE = { position: { x: 0, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: 1 } };

test("odometry says in which frame it is, and what the robot's own is called", () => {
  const message = { header: { frame_id: "odom" }, child_frame_id: "base_link", pose: { pose: HERE } };
  const { frame, base } = poseReader("nav_msgs/Odometry")(message);
  assert.deepEqual([frame, base], ["odom", "base_link"]);
});

test("there and back is where it began", () => {
  const pose = { x: 1.5, y: -2, theta: 0.7 };
  near(compose(pose, inverse(pose)), { x: 0, y: 0, theta: 0 });
});

test("odometry, localization and turtlesim tell poses, a twist does not", () => {
  const pose = { position: { x: 1, y: 2, z: 0 }, orientation: { x: 0, y: 0, z: Math.SQRT1_2, w: Math.SQRT1_2 } };
  const expected = { x: 1, y: 2, theta: Math.PI / 2 };
  near(poseReader("nav_msgs/msg/Odometry")({ pose: { pose } }), expected);
  near(poseReader("geometry_msgs/PoseWithCovarianceStamped")({ pose: { pose } }), expected);
  near(poseReader("turtlesim/msg/Pose")(expected), expected);
  assert.equal(poseReader("geometry_msgs/Twist"), undefined);
});
