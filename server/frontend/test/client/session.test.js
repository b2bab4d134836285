import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Commands } from "../../src/client/session.js";

let advertised, ended, published, commands;

beforeEach(() => {
  advertised = [];
  ended = 0;
  published = [];
  commands = new Commands({
    topic: "/cmd_vel",
    advertise: ({ type }) => {
      advertised.push(type);
      return { publish: (...what) => published.push(what), end: () => (ended += 1) };
    },
    stamp: (timestamp) => ({ t_ms: timestamp + 1000 }),
  });
});

test("a page that watches advertises and publishes nothing", () => {
  commands.useType("geometry_msgs/Twist");
  commands.use(false);
  commands.publish({ forward: 1, turn: 0 }, 5);
  assert.deepEqual(advertised, []);
  assert.deepEqual(published, []);
});

test("a command carries its moment in the relay's time", () => {
  commands.useType("geometry_msgs/Twist");
  commands.use(true);
  commands.publish({ forward: 1, turn: 0 }, 5);
  const [[message, robotether]] = published;
  assert.equal(message.linear.x, 1);
  assert.deepEqual(robotether, { t_ms: 1005 });
});

test("another type, and another connection, are advertised anew", () => {
  commands.use(true);
  commands.useType("geometry_msgs/Twist");
  commands.useType("geometry_msgs/Twist");
  commands.useType("geometry_msgs/TwistStamped");
  assert.deepEqual(advertised, ["geometry_msgs/Twist", "geometry_msgs/TwistStamped"]);
  assert.equal(ended, 1);
  commands.use(false);
  assert.equal(ended, 2);
});

test("a car's steering follows its wheelbase", () => {
  commands.wheelbase = 0.5;
  commands.useType("ackermann_msgs/AckermannDriveStamped");
  commands.use(true);
  commands.publish({ forward: 1, left: 0, turn: 1 }, 5);
  const [[{ drive }]] = published;
  assert.deepEqual(drive, { steering_angle: Math.atan(0.5), speed: 1 });
});
