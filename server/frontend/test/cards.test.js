import assert from "node:assert/strict";
import { test } from "node:test";

import { driverText, healthText, inOrder, presenceText } from "../src/cards.js";

test("online robots come first, then names as a person counts them", () => {
  const robots = [
    { name: "sim10", online: false },
    { name: "sim2", online: false },
    { name: "zoe", online: true },
  ];
  assert.deepEqual(inOrder(robots).map(({ name }) => name), ["zoe", "sim2", "sim10"]);
});

test("a card says since when, and what keeps a robot from being used", () => {
  const since = "2026-01-01T12:03:00Z";
  assert.match(presenceText({ state: "active", online: true, since }), /^Online since .*\d\d:03$/);
  assert.match(presenceText({ state: "active", online: false, since }), /^Offline since .*\d\d:03$/);
  assert.equal(presenceText({ state: "active", online: false, since: null }), "Never seen");
  assert.equal(presenceText({ state: "pending", online: false, since: null }), "Waiting for approval");
});

test("only an online robot's health calls for attention", () => {
  assert.equal(healthText({ online: false, ros: "down", video: "down" }), "");
  assert.equal(healthText({ online: true, ros: "ok", video: "unknown" }), "");
  assert.equal(
    healthText({ online: true, ros: "down", video: "down" }),
    "rosbridge does not answer, video does not answer",
  );
});

test("a card tells who drives, who gets the control and who asks for it", () => {
  const ann = { user: "ann", since: "2026-01-01T12:03:00Z" };
  const ben = { user: "ben", since: "2026-01-01T12:04:00Z" };
  assert.equal(driverText({}), "");
  assert.equal(driverText({ control: { driver: ann } }), "ann");
  assert.equal(driverText({ control: { driver: null, reserved: ben } }), "ben");
  assert.equal(driverText({ control: { driver: ann, waiting: ben } }), "ann; ben asks for the control");
});
