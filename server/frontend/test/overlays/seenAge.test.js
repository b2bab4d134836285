import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { byTestId, part } from "../../src/dom/page.js";
import { SeenAge } from "../../src/overlays/seenAge.js";
import { FakeElement } from "../fakes.js";

let clock, parts, element, seenAge;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = 10_000;
  const root = new FakeElement();
  [element, parts] = ["seen-age", "seen-parts"].map((name) => byTestId(root, name));
  seenAge = new SeenAge(root, { now: () => clock });
});

function pass(ms) {
  for (let passed = 0; passed < ms; passed += 250) {
    clock += 250;
    mock.timers.tick(250);
  }
}

const receive = (ageMs, maxSpeed = null, maxTurn = null) => seenAge.receive({ ageMs, maxSpeed, maxTurn });

const words = () => (element.hidden ? "" : part(element, "value").textContent);

const frame = (at, shownAt) => ({ topic: "/a", sequence: 1, at, shownAt });

test("the age that the robot measures is shown with about its parts, and what it does not know is unknown", () => {
  seenAge.command([frame(9910, 9960), frame(9900, 9970)], 10_000);
  receive(140.4);
  assert.equal(words(), "seen 140 ms ago");
  assert.match(element.title, /about 70 ms until it is shown, 30 ms until the command, 40 ms on to the robot/);
  assert.equal(parts.textContent, element.title);
  receive(null);
  assert.equal(words(), "seen ? ms ago");
  assert.match(element.title, /does not know/);
});

test("a robot that reports nothing while somebody drives leaves the age unknown", () => {
  for (let n = 0; n < 8; n++) {
    seenAge.command([frame(9900, 9960)], clock);
    pass(250);
    assert.equal(words(), "");
  }
  seenAge.command([frame(9900, 9960)], clock);
  pass(250);
  assert.equal(words(), "seen ? ms ago");
  pass(1000);
  assert.equal(words(), "");
});

test("a robot without a camera has no age to show", () => {
  for (let n = 0; n < 20; n++) {
    seenAge.command(null, clock);
    pass(250);
  }
  assert.equal(words(), "");
});

test("the limit that is in force is shown with its reason, as long as the report counts", () => {
  receive(480, 0.52, Math.PI / 3);
  assert.deepEqual([words(), element.dataset.slowed], ["slowed to 0.52 m/s, 60 °/s: seen 480 ms ago", "true"]);
  receive(null, 0.02);
  assert.equal(words(), "slowed to 0.02 m/s: seen ? ms ago");
  pass(2250);
  assert.equal(words(), "");
  receive(140);
  assert.deepEqual([words(), element.dataset.slowed], ["seen 140 ms ago", "false"]);
});
