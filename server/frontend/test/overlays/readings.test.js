import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { byTestId, part } from "../../src/dom/page.js";
import { latencyBreakdown, Readback, Readings, speedText } from "../../src/overlays/readings.js";
import { FakeElement } from "../fakes.js";

for (const [what, parts, rosbridge] of [
  ["what is left", { total: 60, server: 12, robot: 40 }, 8],
  ["never less than nothing, though the parts are measured apart", { total: 50, server: 12, robot: 40 }, 0],
  ["unknown where a part is", { total: 60, server: null, robot: 40 }, null],
]) {
  test(`the robot's rosbridge takes of a round trip ${what}`, () => {
    const { server, robot } = parts;
    assert.deepEqual(latencyBreakdown(parts), { server, robot, rosbridge });
  });
}

test("a number on the page says how good it is, one that came long ago that it is old, and one that is not known nothing", () => {
  const root = new FakeElement();
  let age = null;
  const readings = new Readings(root, { frameAge: () => age, limits: { maxLinear: 1, maxAngular: 1 }, oldMs: 1000 });
  const shown = (name) => [part(byTestId(root, name), "value").textContent, byTestId(root, name).dataset.health];
  mock.timers.tick(250);
  assert.deepEqual(shown("picture-age"), ["-", ""]);
  age = 1200.4;
  mock.timers.tick(250);
  assert.deepEqual(shown("picture-age"), ["1200", "poor"]);
  for (const [reading, expected, words] of [
    [{ medianMs: 60, ageMs: 0 }, ["60", "good"], /12 ms to the server, 40 ms on to the robot, 8 ms in its rosbridge/],
    [{ medianMs: 60, ageMs: 3000 }, ["60", "poor"], /3 s/],
    [null, ["-", ""], /^$/],
  ]) {
    readings.rtt(reading, { server: 12, robot: 40 });
    assert.deepEqual(shown("rtt"), expected);
    assert.match(byTestId(root, "rtt-parts").textContent, words);
  }
});

const ODOM = { name: "/odom", type: "nav_msgs/Odometry" };
const POSE = { name: "/pose", type: "turtlesim/msg/Pose" };

let subscriptions, speed, pose, readback;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  subscriptions = [];
  readback = new Readback({
    subscribe: (spec, handler) => {
      const subscription = { spec, handler, ended: false };
      subscriptions.push(subscription);
      return () => (subscription.ended = true);
    },
    onSpeed: (value) => (speed = value),
    onPose: (value) => (pose = value),
  });
});

test("the speed is subscribed to ten times a second at most, and shown until it is a second old", () => {
  readback.follow(POSE);
  assert.deepEqual(subscriptions[0].spec, { ...POSE, throttleMs: 100 });
  subscriptions[0].handler({ linear_velocity: 0.5, angular_velocity: 0.1 });
  assert.deepEqual(speed, { forward: 0.5, left: 0, turn: 0.1 });
  mock.timers.tick(999);
  assert.notEqual(speed, null);
  mock.timers.tick(1);
  assert.equal(speed, null);
});

test("where the topic is in doubt, there is no speed any more", () => {
  readback.follow(POSE);
  subscriptions[0].handler({ linear_velocity: 0.5, angular_velocity: 0.1 });
  readback.follow(undefined);
  assert.deepEqual([speed, subscriptions[0].ended], [null, true]);
});

test("a speed of which a part is not known is none", () => {
  assert.equal(speedText(null, 0), "-");
  assert.equal(speedText(0.3, null), "-");
  assert.equal(speedText(1e20, 0), "↑ 1.0e+20", "one that is nonsense keeps its place");
  readback.follow(ODOM);
  subscriptions[0].handler({ twist: { twist: { linear: { x: null }, angular: { z: 0.1 } } } });
  assert.deepEqual(speed, { forward: null, left: null, turn: 0.1 });
  assert.equal(pose, null);
});
