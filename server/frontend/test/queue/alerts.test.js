import assert from "node:assert/strict";
import { test } from "node:test";

import { Alerts } from "../../src/queue/alerts.js";

test("an offer sounds at once and every two seconds, and its name and the page's take turns in the title", () => {
  const page = { title: "Queue" };
  const sound = { played: 0, play: () => sound.played++ };
  const alerts = new Alerts({ choices: { all: {} }, page, sound });
  const titles = (count) => Array.from({ length: count }, () => (alerts.tick(), page.title));
  alerts.offer("Offer: sim1");
  assert.deepEqual([page.title, sound.played], ["Offer: sim1", 1]);
  assert.deepEqual(titles(4), ["Queue", "Offer: sim1", "Queue", "Offer: sim1"]);
  assert.equal(sound.played, 3);
  alerts.offer("");
  assert.deepEqual(titles(2), ["Queue", "Queue"]);
  assert.equal(sound.played, 3);
});
