import assert from "node:assert/strict";
import { test } from "node:test";

import { driveSettings } from "../src/settings.js";

test("a robot without settings drives on /cmd_vel with usual limits", () => {
  assert.deepEqual(driveSettings({}), { driveTopic: "/cmd_vel", maxLinear: 1, maxAngular: 1.5 });
});

test("the drive topic is the one that is set, or the guard's first that is a name", () => {
  const guard = { drive_topics: ["*/cmd_vel", "/base/move", "/other"] };
  assert.equal(driveSettings({ guard }).driveTopic, "/base/move");
  assert.equal(driveSettings({ guard, drive_topic: "/a/cmd_vel" }).driveTopic, "/a/cmd_vel");
  assert.equal(driveSettings({ guard: { drive_topics: ["*/cmd_vel"] } }).driveTopic, "/cmd_vel");
});

test("the sliders end where the guard's limit is", () => {
  const guard = { max_speed_m_s: 0.5, max_turn_rad_s: null };
  const { maxLinear, maxAngular } = driveSettings({ guard, max_linear: 2, max_angular: 3 });
  assert.deepEqual([maxLinear, maxAngular], [0.5, 3]);
  assert.equal(driveSettings({ guard: { max_speed_m_s: 4 } }).maxLinear, 4);
});
