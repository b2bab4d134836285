import assert from "node:assert/strict";
import { test } from "node:test";

import { DriveTypeQuery, usualType } from "../../src/client/driveType.js";

const STAMPED = "geometry_msgs/TwistStamped";
const failing = async () => ({ ok: false, values: "rosapi timed out" });
const robot = (type, ros) => async (service) => ({ ok: true, values: service === "/rosapi/topic_type" ? { type } : ros });
const found = (call, set = null) => new DriveTypeQuery({ topic: "/cmd_vel", set }).find(call);

test("the type that the robot reports comes before the one that is set, as the robot spells it", async () => {
  for (const type of ["geometry_msgs/Twist", "geometry_msgs/msg/TwistStamped", "ackermann_msgs/msg/AckermannDriveStamped"]) {
    assert.equal(await found(robot(type, { version: 2, distro: "humble" }), STAMPED), type);
  }
});

test("where the robot reports none that drives, the one that is set is taken, and else its ROS decides", async () => {
  const jazzy = { version: 2, distro: "jazzy" };
  for (const type of ["", "std_msgs/msg/String"]) {
    assert.equal(await found(robot(type, { version: 1, distro: "noetic" }), STAMPED), STAMPED);
    assert.equal(await found(robot(type, jazzy)), "geometry_msgs/msg/TwistStamped");
  }
  assert.equal(await found(failing, STAMPED), STAMPED);
  assert.equal(await found(failing), "geometry_msgs/Twist");
});

test("commands are stamped in ROS 2 from Jazzy on, and in no ROS that is older or not known", () => {
  const stamped = ["jazzy", "kilted", "rolling"].map((distro) => usualType({ version: 2, distro }));
  assert.deepEqual(new Set(stamped), new Set(["geometry_msgs/msg/TwistStamped"]));
  const plain = ["", "foxy", "humble", "iron"].map((distro) => usualType({ version: 2, distro }));
  assert.deepEqual(new Set(plain), new Set(["geometry_msgs/msg/Twist"]));
  assert.equal(usualType({ version: 1, distro: "noetic" }), "geometry_msgs/Twist");
});

test("a robot that fails to answer again is driven by the type that it had", async () => {
  const query = new DriveTypeQuery({ topic: "/cmd_vel" });
  const answers = [robot("", { version: 2, distro: "jazzy" }), failing, robot("geometry_msgs/msg/Twist"), failing];
  const types = [];
  for (const call of answers) types.push(await query.find(call));
  const [stamped, plain] = ["geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"];
  assert.deepEqual(types, [stamped, stamped, plain, plain]);
});
