import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Session } from "../../src/client/session.js";

let advertised, ended, published, session;

beforeEach(() => {
  advertised = [];
  ended = 0;
  published = [];
  session = new Session({ driveTopic: "/cmd_vel" });
  session.clockSync.stamp = (timestamp) => ({ t_ms: timestamp + 1000 });
  session.connection.advertise = ({ name, type }) => {
    advertised.push(`${name} ${type}`);
    return { publish: (...what) => published.push(what), end: () => (ended += 1) };
  };
});

test("a page that watches, and one without a drive topic, advertise and publish nothing", () => {
  session.useType("geometry_msgs/Twist");
  for (const driving of [false, true]) {
    session.use(driving);
    session.publish({ forward: 1, turn: 0 }, 5);
    assert.deepEqual([advertised, published], [[], []]);
    session.driveTopic = "";
  }
});

test("a command carries its moment in the relay's time", () => {
  session.useType("geometry_msgs/Twist");
  session.use(true);
  session.publish({ forward: 1, turn: 0 }, 5);
  const [[message, robotether]] = published;
  assert.equal(message.linear.x, 1);
  assert.deepEqual(robotether, { t_ms: 1005 });
});

test("another type, and another connection, are advertised anew", () => {
  session.use(true);
  session.useType("geometry_msgs/Twist");
  session.useType("geometry_msgs/Twist");
  session.useType("geometry_msgs/TwistStamped");
  assert.deepEqual(advertised, ["/cmd_vel geometry_msgs/Twist", "/cmd_vel geometry_msgs/TwistStamped"]);
  assert.equal(ended, 1);
  session.use(false);
  assert.equal(ended, 2);
});

test("a car's steering follows its wheelbase", () => {
  session.wheelbase = 0.5;
  session.useType("ackermann_msgs/AckermannDriveStamped");
  session.use(true);
  session.publish({ forward: 1, left: 0, turn: 1 }, 5);
  const [[{ drive }]] = published;
  assert.deepEqual(drive, { steering_angle: Math.atan(0.5), speed: 1 });
});
