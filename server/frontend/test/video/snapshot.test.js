import assert from "node:assert/strict";
import { test } from "node:test";

import { snapshotName, snapshotUrl } from "../../src/video/snapshot.js";

test("a still is asked for at full quality", () => {
  assert.equal(snapshotUrl("sim 1", "/camera/image_raw"), "/robots/sim%201/video/snapshot?topic=/camera/image_raw&quality=100");
});

test("a file is named after robot, camera and time, in plain letters", () => {
  const time = new Date("2026-01-02T03:04:05.678Z");
  assert.equal(snapshotName("sim1", "/camera/image_raw", time), "sim1-camera-image-raw-20260102T030405Z.jpg");
  assert.equal(snapshotName("sim1", "../..", time), "sim1-camera-20260102T030405Z.jpg");
});
