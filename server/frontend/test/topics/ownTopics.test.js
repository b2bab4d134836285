import assert from "node:assert/strict";
import { test } from "node:test";

import { chooseTopic, ownTopics } from "../../src/topics/ownTopics.js";

const TYPES = { cmd_vel: "geometry_msgs/msg/Twist", scan: "sensor_msgs/msg/LaserScan", odom: "nav_msgs/msg/Odometry" };
const topic = (name, type = TYPES[name.split("/").at(-1)] ?? "") => ({ name, type });
const names = (topics) => topics.map(({ name }) => name);
const own = (driveTopic, ...all) =>
  names(
    ownTopics(
      all.map((name) => topic(name)),
      driveTopic,
    ),
  );
const choose = (kind, driveTopic, ...topics) => chooseTopic(kind, topics, { driveTopic });

test("what another robot of the graph has is not this robot's, also where one name begins like the other", () => {
  const all = ["/robot1/cmd_vel", "/robot1/scan", "/robot10/cmd_vel", "/robot10/scan", "/map", "/lidar/scan"];
  assert.deepEqual(own("/robot1/cmd_vel", ...all), ["/robot1/cmd_vel", "/robot1/scan", "/map", "/lidar/scan"]);
  assert.deepEqual(own("/robot10/cmd_vel", ...all), ["/robot10/cmd_vel", "/robot10/scan", "/map", "/lidar/scan"]);
});

test("namespaces within another are told apart, and a robot's controller is its own", () => {
  const all = ["/site/a/base/cmd_vel", "/site/a/scan", "/site/b/base/cmd_vel", "/site/b/scan", "/site/map"];
  assert.deepEqual(own("/site/b/base/cmd_vel", ...all), ["/site/b/base/cmd_vel", "/site/b/scan", "/site/map"]);
});

test("a robot without a namespace has nothing of one that has", () => {
  const all = ["/cmd_vel", "/odom", "/camera/image_raw", "/robot1/cmd_vel", "/robot1/scan"];
  assert.deepEqual(own("/cmd_vel", ...all), ["/cmd_vel", "/odom", "/camera/image_raw"]);
});

test("a drive topic whose type nobody knows is one by its name", () => {
  assert.deepEqual(names(ownTopics([topic("/a/cmd_vel", ""), topic("/a/odom"), topic("/b/odom")], "/b/cmd_vel")), ["/b/odom"]);
});

test("without a drive topic all are the robot's", () => {
  assert.deepEqual(own("", "/a/cmd_vel", "/b/cmd_vel"), ["/a/cmd_vel", "/b/cmd_vel"]);
});

test("the nearest namespace comes first, then the usual name, then what lies less deep", () => {
  const scans = (...all) => all.map((name) => topic(name, TYPES.scan));
  const chosen = (...all) => choose("scan", "/r2/base/cmd_vel", ...scans(...all)).topic.name;
  assert.equal(chosen("/scan", "/r2/laser", "/r2/base/front"), "/r2/base/front");
  assert.equal(chosen("/scan", "/r2/laser", "/r2/scan", "/r2/front/scan"), "/r2/scan");
  assert.equal(chosen("/r2/front/scan", "/r2/laser"), "/r2/laser");
  assert.equal(chosen("/front/scan", "/scan"), "/scan");
});

test("of several that fit equally well none is chosen, unless the settings name one", () => {
  const scans = [topic("/rear/scan"), topic("/front/scan")];
  assert.deepEqual(choose("scan", "/cmd_vel", ...scans), { topic: undefined, candidates: ["/front/scan", "/rear/scan"] });
  const named = (name) => chooseTopic("scan", scans, { named: name, driveTopic: "/cmd_vel" });
  assert.deepEqual(named("/rear/scan"), { topic: scans[0], candidates: [] });
  assert.deepEqual(named("/hidden").topic, topic("/hidden", "sensor_msgs/LaserScan"));
  assert.deepEqual(choose("map", "/cmd_vel", ...scans), { topic: undefined, candidates: [] });
});

test("frames come on the usual topics, or on those of the robot's namespace", () => {
  const usual = [topic("/tf", "tf2_msgs/msg/TFMessage"), topic("/tf_static", "tf2_msgs/msg/TFMessage")];
  const ours = [topic("/a1/tf", "tf/tfMessage"), topic("/a1/tf_static", "tf2_msgs/TFMessage"), topic("/x/tf", "std_msgs/String")];
  const frames = (driveTopic, ...all) => ["tf", "tfStatic"].map((kind) => choose(kind, driveTopic, ...all).topic);
  assert.deepEqual(frames("/cmd_vel", ...ours, ...usual), usual);
  assert.deepEqual(frames("/a1/cmd_vel", ...ours, ...usual), ours.slice(0, 2));
  assert.deepEqual(frames("/cmd_vel"), [undefined, undefined]);
});

test("the aggregated diagnostics come before the raw ones", () => {
  const all = ["/diagnostics", "/diagnostics_agg"].map((name) => topic(name, "diagnostic_msgs/DiagnosticArray"));
  assert.equal(choose("diagnostics", "/cmd_vel", ...all).topic.name, "/diagnostics_agg");
});
