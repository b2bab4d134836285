import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { cameraTopics, offeredCameras } from "../../src/topics/discovery.js";
import { chooseTopic, ownTopics } from "../../src/topics/ownTopics.js";

const topic = (name, type = "sensor_msgs/msg/LaserScan") => ({ name, type });
const names = (topics) => topics.map(({ name }) => name);
const choose = (kind, driveTopic, ...topics) => chooseTopic(kind, topics, { driveTopic });

const CASES = JSON.parse(readFileSync(new URL("ros_graphs.json", import.meta.url), "utf8"));

for (const { why, drive_topic: driveTopic, topics, own, odometry, cameras } of CASES) {
  test(`of one graph page and agent choose the same: ${why}`, () => {
    const found = ownTopics(
      Object.entries(topics).map(([name, type]) => ({ name, type })),
      driveTopic,
    );
    assert.deepEqual(names(found).sort(), own);
    assert.equal(choose("odometry", driveTopic, ...found).topic?.name ?? null, odometry);
    const known = cameraTopics(found);
    assert.deepEqual(known.length ? offeredCameras({ known }).map(({ topic }) => topic) : [], cameras);
  });
}

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
