import assert from "node:assert/strict";
import { test } from "node:test";

import { driverText, healthText, presenceText, utcText } from "../../src/fleet/cards.js";
import { batteryText } from "../../src/overlays/battery.js";

test("a card says since when, and what keeps a robot from being used", () => {
  const since = "2026-01-01T12:03:00Z";
  assert.match(presenceText({ state: "active", online: true, since }), /^Online since .*\d\d:03$/);
  assert.match(presenceText({ state: "active", online: false, since }), /^Offline since .*\d\d:03$/);
  assert.equal(presenceText({ state: "active", online: false, since: null }), "Never seen");
  assert.equal(presenceText({ state: "pending", online: false, since: null }), "Awaiting approval");
});

test("the times of a card are in UTC on hover", () => {
  const since = "2026-01-01T12:03:00+02:00";
  const stopped = { by: "zoe", at: "2026-01-01T12:04:05.123456Z", confirmed: true };
  assert.equal(utcText({ state: "active", online: true, since }), "Online since 2026-01-01 10:03:00 UTC");
  assert.equal(
    utcText({ state: "active", online: false, since, control: { stopped } }),
    "Offline since 2026-01-01 10:03:00 UTC\nStopped by zoe at 2026-01-01 12:04:05 UTC",
  );
  assert.equal(utcText({ state: "active", online: false, since: null }), "");
});

test("an offline robot calls for attention, and says why it is offline if that is known", () => {
  const away = { online: false, since: null, ros: "down", video: "down" };
  assert.equal(healthText({ ...away, offline_reason: "The robot went silent." }), "The robot went silent.");
  assert.equal(utcText({ ...away, offline_reason: "The robot went silent." }), "The robot went silent.");
  assert.equal(healthText(away), "It is not known why.");
});

test("an online robot's health calls for attention", () => {
  assert.equal(healthText({ online: true, ros: "ok", video: "unknown" }), "");
  assert.equal(healthText({ online: true, ros: "down", video: "down" }), "rosbridge does not answer, video does not answer");
  assert.equal(healthText({ online: true, control: { guard: "down" } }), "its guard does not answer");
  assert.equal(healthText({ online: true, control: { guard: "off" } }), "");
});

test("a card tells who drives, who gets the control and who asks for it", () => {
  const ann = { user: "ann", since: "2026-01-01T12:03:00Z" };
  const ben = { user: "ben", since: "2026-01-01T12:04:00Z" };
  assert.equal(driverText({}), "");
  assert.equal(driverText({ control: { driver: ann } }), "ann");
  assert.equal(driverText({ control: { driver: null, reserved: ben } }), "ben");
  assert.equal(driverText({ control: { driver: ann, waiting: ben } }), "ann; ben asks for control");
});

test("a card tells the battery, and one that is low calls for attention unless it is charged", () => {
  const robot = (percent, charging) => ({ online: true, battery: { percent, charging } });
  assert.equal(batteryText(robot(81.4, false)), "81 %");
  assert.equal(batteryText(robot(null, false)), "?");
  assert.equal(healthText(robot(null, false)), "");
  assert.equal(batteryText(robot(12, true)), "12 %, charging");
  assert.equal(batteryText(robot(12, false)), "12 %, low");
  assert.equal(batteryText({ online: true, battery: null }), "");
  assert.equal(batteryText({ ...robot(12, false), online: false }), "");
  assert.equal(healthText(robot(12, false)), "battery low");
  assert.equal(healthText(robot(12, true)), "");
});
