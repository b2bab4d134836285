import assert from "node:assert/strict";
import { test } from "node:test";

import { driveSettings } from "../../src/pages/settings.js";

test("a robot without settings drives on /cmd_vel with usual limits", () => {
  assert.deepEqual(driveSettings({}), {
    driveTopic: "/cmd_vel",
    driveType: null,
    kind: "differential",
    wheelbase: null,
    limits: { maxLinear: 1, maxAngular: 1.5 },
    holdAfterMs: 1000,
    maxAgeMs: 500,
  });
});

test("the drive topic is the one that is set, or the guard's first that is a name", () => {
  const guard = { drive_topics: ["*/cmd_vel", "/base/move", "/other"] };
  assert.equal(driveSettings({ guard, page: { drive_topic: null } }).driveTopic, "/base/move");
  assert.equal(driveSettings({ guard, page: { drive_topic: "/a/cmd_vel" } }).driveTopic, "/a/cmd_vel");
  assert.equal(driveSettings({ guard: { drive_topics: ["*/cmd_vel"] } }).driveTopic, "/cmd_vel");
});

test("where only patterns are drive topics that /cmd_vel does not fit, there is none to publish to", () => {
  const found = (...drive_topics) => driveSettings({ guard: { drive_topics } }).driveTopic;
  assert.deepEqual([found("/*/cmd_vel"), found("/base*"), found("*cmd_vel_safe")], ["", "", ""]);
  assert.deepEqual([found("/*/cmd_vel", "/cmd_*"), found("*")], ["/cmd_vel", "/cmd_vel"]);
});

test("the type of drive commands may be set", () => {
  assert.equal(driveSettings({ page: { drive_type: "geometry_msgs/TwistStamped" } }).driveType, "geometry_msgs/TwistStamped");
});

test("the sliders end where the guard's limit is", () => {
  const guard = { max_speed_m_s: 0.5, max_turn_rad_s: null };
  const { limits } = driveSettings({ guard, page: { max_speed_m_s: 2, max_turn_rad_s: 3 } });
  assert.deepEqual(limits, { maxLinear: 0.5, maxAngular: 3 });
  assert.equal(driveSettings({ guard: { max_speed_m_s: 4 } }).limits.maxLinear, 4);
});

test("driving is held for an old picture unless the settings say never", () => {
  assert.equal(driveSettings({ page: { hold_after_ms: 2500 } }).holdAfterMs, 2500);
  assert.equal(driveSettings({ page: { hold_after_ms: null } }).holdAfterMs, null);
});

test("a robot that steers has its wheelbase", () => {
  const { kind, wheelbase } = driveSettings({ page: { kind: "ackermann", wheelbase_m: 0.5 } });
  assert.deepEqual([kind, wheelbase], ["ackermann", 0.5]);
});
