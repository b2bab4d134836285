import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Discovery } from "../../src/topics/discovery.js";

let found, discovery;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  found = [];
  discovery = new Discovery({ driveTopic: "/cmd_vel", onFound: (what) => found.push(what) });
});

const robot = (topics, driveType = "") => {
  const asked = [];
  const call = async (service, request) => {
    asked.push({ service, request });
    if (service === "/rosapi/topic_type") return { ok: true, values: { type: driveType } };
    return { ok: true, values: { topics: Object.keys(topics), types: Object.values(topics) } };
  };
  return { call, asked };
};

test("a whole robot is found in one round", async () => {
  const { call, asked } = robot(
    { "/odom": "nav_msgs/msg/Odometry", "/camera/image_raw": "sensor_msgs/msg/Image" },
    "geometry_msgs/msg/Twist",
  );
  await discovery.run(call);
  mock.timers.tick(60_000);
  assert.deepEqual(found, [
    {
      twistType: "geometry_msgs/msg/Twist",
      speed: { name: "/odom", type: "nav_msgs/msg/Odometry" },
      cameras: ["/camera/image_raw"],
      topics: [
        { name: "/odom", type: "nav_msgs/msg/Odometry" },
        { name: "/camera/image_raw", type: "sensor_msgs/msg/Image" },
      ],
    },
  ]);
  assert.equal(asked.length, 2);
  assert.deepEqual(asked[1].request, { topic: "/cmd_vel" });
});

test("a robot without rosapi gets the usual names", async () => {
  await discovery.run(async () => ({ ok: false, values: "no such service" }));
  assert.deepEqual(found, [{ twistType: "geometry_msgs/Twist", speed: undefined, cameras: [], topics: [] }]);
  discovery.stop();
});

test("a robot that is still starting is asked again, until the connection ends", async () => {
  const { call, asked } = robot({});
  await discovery.run(call);
  mock.timers.tick(5000);
  assert.equal(asked.length, 4);
  discovery.stop();
  mock.timers.tick(60_000);
  assert.equal(asked.length, 4);
});

test("an answer that comes after the connection ended is ignored", async () => {
  const running = discovery.run(robot({}).call);
  discovery.stop();
  await running;
  assert.deepEqual(found, []);
});

test("the odometry that the settings name comes before any other, if it is one", async () => {
  const named = (odometryTopic) => new Discovery({ driveTopic: "/cmd_vel", odometryTopic, onFound: (what) => found.push(what.speed) });
  const topics = { "/odom": "nav_msgs/Odometry", "/wheels": "nav_msgs/msg/Odometry", "/scan": "sensor_msgs/LaserScan" };
  for (const name of ["/wheels", "/scan"]) {
    const one = named(name);
    await one.run(robot(topics).call);
    one.stop();
  }
  assert.deepEqual(found, [{ name: "/wheels", type: "nav_msgs/msg/Odometry" }, undefined]);
});

test("who wants to know now is answered on the link that stands, and not without one", async () => {
  const { call, asked } = robot({ "/odom": "nav_msgs/Odometry", "/c": "sensor_msgs/Image" });
  await discovery.run(call);
  discovery.refresh();
  assert.equal(asked.length, 4);
  discovery.stop();
  discovery.refresh();
  assert.equal(asked.length, 4);
});

test("a robot that fails to tell its drive type again is driven by the one that it told", async () => {
  const { call } = robot({}, "geometry_msgs/msg/TwistStamped");
  await discovery.run(call);
  await discovery.run(async () => ({ ok: false, values: "rosapi timed out" }));
  await discovery.run(robot({}, "geometry_msgs/msg/Twist").call);
  discovery.stop();
  assert.deepEqual(
    found.map(({ twistType }) => twistType),
    ["geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"],
  );
});
