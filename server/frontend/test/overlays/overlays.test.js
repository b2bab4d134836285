import assert from "node:assert/strict";
import { beforeEach, describe, mock, test } from "node:test";

import { byTestId, part } from "../../src/dom/page.js";
import { Diagnostics, Overlays, readLevel } from "../../src/overlays/overlays.js";
import { Readback, Readings, latencyBreakdown, speedText } from "../../src/overlays/readings.js";
import { SeenAge } from "../../src/overlays/seenAge.js";
import { FakeElement } from "../fakes.js";

const DIAGNOSTICS = { name: "/diagnostics", type: "diagnostic_msgs/DiagnosticArray" };

let clock, root, specs, handlers, overlays;

beforeEach(() => {
  clock = 0;
  specs = [];
  handlers = {};
  root = new FakeElement();
  const subscribe = (spec, handler) => {
    specs.push(spec);
    handlers[spec.name] = handler;
    return () => delete handlers[spec.name];
  };
  overlays = new Overlays(root, { subscribe, now: () => clock });
});

for (const [online, battery, ...expected] of [
  [true, { percent: 12, charging: false }, "12 %, low", "poor"],
  [true, { percent: 30, charging: false }, "30 %", "fair"],
  [true, { percent: 12, charging: true }, "12 %, charging", "good"],
  [true, { percent: null, charging: false }, "?", ""],
  [true, null, "-", ""],
  [false, { percent: 80, charging: false }, "-", ""],
]) {
  test(`the battery of a robot that is ${online ? "online" : "offline"} and says ${JSON.stringify(battery)}: ${expected}`, () => {
    overlays.showBattery({ online, battery });
    const { textContent, dataset } = part(root, "battery");
    assert.deepEqual([textContent, dataset.health], expected);
  });
}

test("the same topic is subscribed to once, and each node's part waits instead of being lost", () => {
  overlays.follow({ diagnostics: DIAGNOSTICS });
  overlays.follow({ diagnostics: DIAGNOSTICS });
  assert.equal(specs.length, 1);
  assert.ok(specs[0].queueLength > 1);
  overlays.follow({});
  assert.deepEqual(Object.keys(handlers), []);
});

const status = (name, level, message = "") => ({ status: [{ name, level, message }] });

test("a level is a number, or a byte as bridges write it", () => {
  assert.deepEqual([0, 1, 2, 3].map(readLevel), ["ok", "warn", "error", "stale"]);
  assert.deepEqual(["AA==", "Ag==", "\u0001", "2"].map(readLevel), ["ok", "error", "warn", "error"]);
  assert.deepEqual([7, "?!", null, undefined, {}].map(readLevel), ["stale", "stale", "stale", "stale", "stale"]);
});

test("what is no status is left out, and the others count", () => {
  const diagnostics = new Diagnostics();
  for (const status of [null, 5, [null, { name: 3 }, { name: "motor", level: 2 }]]) diagnostics.receive({ status }, 0);
  assert.deepEqual(diagnostics.list(0), [{ name: "motor", level: "error", message: "" }]);
});

test("nothing is known before the first message, nor of a part that says nothing for ten seconds", () => {
  const diagnostics = new Diagnostics();
  assert.equal(diagnostics.worst(0), null);
  diagnostics.receive(status("motor", 0), 0);
  assert.equal(diagnostics.worst(10_001).level, "stale");
});

test("a list that is cut says what is left out", () => {
  const list = { replaceChildren: (...rows) => (list.rows = rows) };
  globalThis.document = { createElement: () => new FakeElement() };
  overlays.details.querySelector = () => list;
  overlays.diagnostics.receive({ status: Array.from({ length: 75 }, (_, i) => ({ name: `part ${i}`, level: 2 })) }, 0);
  overlays.showList();
  assert.deepEqual([list.rows.length, list.rows.at(-1).children[0]], [61, "15 more, none of them worse"]);
});

test("of names without end the newest count, and it is said", () => {
  const { diagnostics } = overlays;
  diagnostics.receive({}, 0);
  for (let i = 0; i < 1000; i++) diagnostics.receive(status(`part ${i}`, 0), 0);
  assert.equal(diagnostics.list(0).length, 500);
  diagnostics.receive(status("motor", 2), 0);
  assert.deepEqual([diagnostics.list(0).length, diagnostics.worst(0).level], [500, "error"]);
  overlays.show();
  assert.equal(part(overlays.details, "diagnostics-worst").textContent, "1 error, of the newest 500 parts");
});

describe("readings", () => {
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
});

describe("the age of what is seen", () => {
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
});
