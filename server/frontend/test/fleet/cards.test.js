import assert from "node:assert/strict";
import { test } from "node:test";

import { driverText, healthText, robotOf } from "../../src/fleet/cards.js";

const AWAY = { state: "active", online: false, since: null, ros: "down", video: "down" };

const battery = (percent, charging = false) => ({ online: true, battery: { percent, charging } });

// What calls for attention.
for (const [robot, health] of [
  [{ online: true, ros: "ok", video: "unknown" }, ""],
  [{ online: true, ros: "down", video: "down" }, "rosbridge does not answer, video does not answer"],
  [{ online: true, control: { guard: "down" } }, "its guard does not answer"],
  [{ online: true, control: { guard: "off" } }, ""],
  [battery(12), "battery low"],
  [{ online: true, battery: null }, ""],
  [{ ...battery(12), online: false }, "It is not known why."],
  [{ ...AWAY, offline_reason: "The robot went silent." }, "The robot went silent."],
  [robotOf({ online: "false", offlineReason: "The server stopped." }), "The server stopped."],
]) {
  test(`a card says of ${JSON.stringify(robot)}: ${health}`, () => assert.equal(healthText(robot), health));
}

test("a card tells who drives, who gets the control and who asks for it", () => {
  const ann = { user: "ann", since: "2026-01-01T12:03:00Z" };
  const ben = { user: "ben", since: "2026-01-01T12:04:00Z" };
  assert.equal(driverText({}), "");
  assert.equal(driverText({ control: { driver: ann } }), "ann");
  assert.equal(driverText({ control: { driver: null, reserved: ben } }), "none; reserved for ben");
  assert.equal(driverText({ control: { driver: ann, waiting: ben } }), "ann; ben asks for control");
});
