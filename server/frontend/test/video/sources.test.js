import assert from "node:assert/strict";
import { test } from "node:test";

import { cameraTopics, offeredCameras, topicOf } from "../../src/video/sources.js";

const topic = (name, type) => ({ name, type });

test("a camera and its compressed twin are one, and depth is no picture", () => {
  const topics = [
    topic("/rear/image_raw", "sensor_msgs/msg/Image"),
    topic("/front/image_raw/compressed", "sensor_msgs/msg/CompressedImage"),
    topic("/front/image_raw", "sensor_msgs/Image"),
    topic("/front/image_raw/compressedDepth", "sensor_msgs/CompressedImage"),
    topic("/only", "sensor_msgs/CompressedImage"),
    topic("/scan", "sensor_msgs/LaserScan"),
  ];
  assert.deepEqual(cameraTopics(topics), ["/front/image_raw", "/only", "/rear/image_raw"]);
});

test("the settings' topic comes first, then the usual name, then any of the type", () => {
  const topics = [topic("/a/scan", "sensor_msgs/msg/LaserScan"), topic("/scan", "sensor_msgs/msg/LaserScan")];
  assert.equal(topicOf("scan", topics).name, "/scan");
  assert.equal(topicOf("scan", topics, "/a/scan").type, "sensor_msgs/msg/LaserScan");
  assert.equal(topicOf("scan", topics.slice(0, 1)).name, "/a/scan");
  assert.deepEqual(topicOf("scan", topics, "/hidden"), topic("/hidden", "sensor_msgs/LaserScan"));
  assert.equal(topicOf("map", topics), undefined);
});

test("the aggregated diagnostics come before the raw ones", () => {
  const type = "diagnostic_msgs/DiagnosticArray";
  assert.equal(topicOf("diagnostics", [topic("/diagnostics", type), topic("/diagnostics_agg", type)]).name, "/diagnostics_agg");
});

test("configured cameras are all that are offered, and before anything is known the usual one", () => {
  const configured = [{ topic: "/x", name: "Front", turned_deg: 180 }];
  assert.equal(offeredCameras({ configured, known: ["/y"] }), configured);
  assert.deepEqual(offeredCameras({ known: ["/y"] }), [{ topic: "/y", name: "y", turned_deg: 0 }]);
  assert.equal(offeredCameras({})[0].topic, "/camera/image_raw");
});

test("a camera is named by what tells it from the others", () => {
  const names = (...known) => offeredCameras({ known }).map(({ name }) => name);
  assert.deepEqual(names("/front/image_raw", "/arm/rear/image_rect_color", "/image_raw"), ["front", "arm/rear", "/image_raw"]);
  assert.deepEqual(names("/front/image_raw", "/front/image_mono"), ["/front/image_raw", "/front/image_mono"]);
});
