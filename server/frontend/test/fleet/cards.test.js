import assert from "node:assert/strict";
import { test } from "node:test";

import { healthText, robotOf, utcText } from "../../src/fleet/cards.js";
import { batteryText } from "../../src/overlays/battery.js";

const SINCE = "2026-01-01T12:03:00Z";

const AWAY = { state: "active", online: false, since: null, ros: "down", video: "down" };

// What is hovered: times in UTC, and why it is offline.
for (const [robot, words] of [
  [{ state: "active", online: true, since: "2026-01-01T12:03:00+02:00" }, "Online since 2026-01-01 10:03:00 UTC"],
  [
    { ...AWAY, since: SINCE, control: { stopped: { by: "zoe", at: "2026-01-01T12:04:05.123456Z", confirmed: true } } },
    "Offline since 2026-01-01 12:03:00 UTC\nStopped by zoe at 2026-01-01 12:04:05 UTC",
  ],
  [{ ...AWAY, offline_reason: "The robot went silent." }, "The robot went silent."],
  [AWAY, ""],
]) {
  test(`a card says on hover: ${words}`, () => assert.equal(utcText(robot), words));
}

const battery = (percent, charging = false) => ({ online: true, battery: { percent, charging } });

// What calls for attention, and what is said of the battery.
for (const [robot, health, charge = ""] of [
  [{ online: true, ros: "ok", video: "unknown" }, ""],
  [{ online: true, ros: "down", video: "down" }, "rosbridge does not answer, video does not answer"],
  [{ online: true, control: { guard: "down" } }, "its guard does not answer"],
  [{ online: true, control: { guard: "off" } }, ""],
  [battery(81.4), "", "81 %"],
  [battery(null), "", "?"],
  [battery(12, true), "", "12 %, charging"],
  [battery(12), "battery low", "12 %, low"],
  [{ online: true, battery: null }, ""],
  [{ ...battery(12), online: false }, "It is not known why."],
  [{ ...AWAY, offline_reason: "The robot went silent." }, "The robot went silent."],
  [robotOf({ online: "false", offlineReason: "The server stopped." }), "The server stopped."],
]) {
  test(`a card says of ${JSON.stringify(robot)}: ${health}, ${charge}`, () => {
    assert.deepEqual([healthText(robot), batteryText(robot)], [health, charge]);
  });
}
