import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Alerts } from "../../src/queue/alerts.js";
import { Choices } from "../../src/dom/page.js";

let page, sound, kept;

beforeEach(() => {
  page = { title: "Queue" };
  sound = { played: 0, isSilent: false, play: () => sound.played++, unlock: async () => {} };
  kept = new Map();
});

const store = { read: (name) => kept.get(name) ?? null, write: (name, value) => kept.set(name, value) };
const open = () => new Alerts({ choices: new Choices("alerts", store), page, sound });

function titles(alerts, count) {
  return Array.from({ length: count }, () => (alerts.tick(), page.title));
}

test("an offer sounds at once and every two seconds, and its name and the page's take turns in the title", () => {
  const alerts = open();
  alerts.offer("Offer: sim1");
  assert.deepEqual([page.title, sound.played], ["Offer: sim1", 1]);
  assert.deepEqual(titles(alerts, 4), ["Queue", "Offer: sim1", "Queue", "Offer: sim1"]);
  assert.equal(sound.played, 3);
  alerts.offer("");
  assert.deepEqual(titles(alerts, 2), ["Queue", "Queue"]);
  assert.equal(sound.played, 3);
});

test("each is switched off by itself, and stays so at the next visit", async () => {
  const alerts = open();
  alerts.offer("Offer: sim1");
  await alerts.set("title", false);
  assert.deepEqual(titles(alerts, 2), ["Queue", "Queue"]);
  assert.equal(sound.played, 2);
  await alerts.set("sound", false);
  titles(alerts, 4);
  const next = open();
  next.offer("Offer: sim2");
  assert.deepEqual([page.title, sound.played, next.isOn("sound")], ["Queue", 2, false]);
});
