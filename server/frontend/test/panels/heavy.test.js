import assert from "node:assert/strict";
import { test } from "node:test";

import { isHeavy } from "../../src/panels/heavy.js";

test("pictures and clouds are heavy in either ROS's spelling", () => {
  assert.equal(isHeavy("sensor_msgs/Image"), true);
  assert.equal(isHeavy("sensor_msgs/msg/PointCloud2"), true);
  assert.equal(isHeavy("sensor_msgs/LaserScan"), false);
  assert.equal(isHeavy(""), false);
});
