import assert from "node:assert/strict";
import { test } from "node:test";

import { driveSettings } from "../../src/pages/settings.js";

const GUARD = { drive_topics: ["*/cmd_vel", "/base/move", "/other"] };
const fits = (...drive_topics) => ({ guard: { drive_topics } });

for (const [what, settings, expected] of [
  ["the drive topic is the guard's first that is a name", { guard: GUARD, page: { drive_topic: null } }, { driveTopic: "/base/move" }],
  ["or the one that is set", { guard: GUARD, page: { drive_topic: "/a/cmd_vel" } }, { driveTopic: "/a/cmd_vel" }],
  ["or the usual one, where a pattern fits it", fits("*/cmd_vel"), { driveTopic: "/cmd_vel" }],
  ["or where one of several does", fits("/*/cmd_vel", "/cmd_*"), { driveTopic: "/cmd_vel" }],
  ["or where all do", fits("*"), { driveTopic: "/cmd_vel" }],
  ["and else none: of another namespace", fits("/*/cmd_vel"), { driveTopic: "" }],
  ["of another base", fits("/base*"), { driveTopic: "" }],
  ["of another end", fits("*cmd_vel_safe"), { driveTopic: "" }],
  ["the type of drive commands may be set", { page: { drive_type: "geometry_msgs/Twist" } }, { driveType: "geometry_msgs/Twist" }],
  ["old video pauses driving after a time that is set", { page: { hold_after_ms: 2500 } }, { holdAfterMs: 2500 }],
  ["or never", { page: { hold_after_ms: null } }, { holdAfterMs: null, oldMs: 1000 }],
  ["who sees late is slowed", { guard: { blind_m: null, blind_deg: 30 } }, { isLimitedByAge: true }],
  ["unless both limits are off", { guard: { blind_m: null, blind_deg: null } }, { isLimitedByAge: false }],
  ["a robot that steers has a wheelbase", { page: { kind: "ackermann", wheelbase_m: 0.5 } }, { kind: "ackermann", wheelbase: 0.5 }],
]) {
  test(`settings: ${what}`, () => {
    const found = driveSettings(settings);
    for (const [name, value] of Object.entries(expected)) assert.equal(found[name], value, name);
  });
}

test("the sliders end where the guard's limit is", () => {
  const guard = { max_speed_m_s: 0.5, max_turn_rad_s: null };
  const { limits } = driveSettings({ guard, page: { max_speed_m_s: 2, max_turn_rad_s: 3 } });
  assert.deepEqual(limits, { maxLinear: 0.5, maxAngular: 3 });
  assert.equal(driveSettings({ guard: { max_speed_m_s: 4 } }).limits.maxLinear, 4);
});
