import assert from "node:assert/strict";
import { test } from "node:test";

import { driveMessage, isSteered, parse, speedReader } from "../../src/client/rosbridge.js";

test("a stamped type gets the same twist in an envelope", () => {
  const speed = { forward: 1, left: 0.5, turn: 2 };
  const twist = { linear: { x: 1, y: 0.5, z: 0 }, angular: { x: 0, y: 0, z: 2 } };
  assert.deepEqual(driveMessage("geometry_msgs/msg/Twist", speed), twist);
  assert.deepEqual(driveMessage("geometry_msgs/msg/TwistStamped", speed).twist, twist);
});

const car = (twist, wheelbase) => driveMessage("ackermann_msgs/msg/AckermannDriveStamped", twist, { wheelbase }).drive;

test("a car steers so that it follows the twist's curve, forwards and backwards", () => {
  const { speed, steering_angle } = car({ forward: 2, turn: 1 }, 0.5);
  assert.equal(speed, 2);
  assert.ok(Math.abs((2 * Math.tan(steering_angle)) / 0.5 - 1) < 1e-9);
  assert.equal(car({ forward: -2, turn: -1 }, 0.5).steering_angle, steering_angle);
  assert.equal(car({ forward: 2, turn: -1 }, 0.5).steering_angle, -steering_angle);
});

test("a car that stands points its wheels ahead, and one of unknown size steers all the same", () => {
  assert.deepEqual(car({ forward: 0, left: 0, turn: 1 }, 0.5), { steering_angle: 0, speed: 0 });
  assert.ok(car({ forward: 1, turn: 1 }, null).steering_angle > 0);
});

test("speed is read from odometry and from turtlesim's pose", () => {
  const odometry = { twist: { twist: { linear: { x: 0.5, y: 0.2 }, angular: { z: -1 } } } };
  assert.deepEqual(speedReader("nav_msgs/Odometry")(odometry), {
    forward: 0.5,
    left: 0.2,
    turn: -1,
  });
  const pose = { linear_velocity: 0.5, angular_velocity: -1 };
  assert.deepEqual(speedReader("turtlesim/msg/Pose")(pose), { forward: 0.5, left: 0, turn: -1 });
});

test("only a car's type is steered, under its ROS 1 and ROS 2 name", () => {
  assert.equal(isSteered("ackermann_msgs/AckermannDriveStamped"), true);
  assert.equal(isSteered("ackermann_msgs/msg/AckermannDriveStamped"), true);
  assert.equal(isSteered("geometry_msgs/Twist"), false);
  assert.equal(isSteered(null), false);
});

test("numbers that are none are read as rosbridge writes them, and texts stay as they are", () => {
  const text = '{"data": [NaN, -Infinity, Infinity, 1.5, null], "text": "NaN, \\"Infinity\\" and -Infinity"}';
  assert.deepEqual(parse(text), { data: [null, -Infinity, Infinity, 1.5, null], text: 'NaN, "Infinity" and -Infinity' });
  assert.equal(parse('{"data": NaNs}'), null);
  assert.equal(parse("{"), null);
});
