import assert from "node:assert/strict";
import { test } from "node:test";

import { TopicChoice } from "../../src/topics/ownTopics.js";
import { MAP } from "../../src/video/layout.js";
import { MainTimestamp, View, viewActionOf } from "../../src/video/view.js";

const within = (...selectors) => ({ closest: (asked) => selectors.some((one) => asked.includes(one)) || null });

const DRIVING = ["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE", "ArrowUp", "Space", "Digit5", "Digit0"];

for (const [what, event, action] of [
  ["C is the next camera", { code: "KeyC" }, { next: true }],
  ["a digit names one", { code: "Digit3" }, { nth: 2 }],
  ["so does one of the keypad", { code: "Numpad1" }, { nth: 0 }],
  ["F is fullscreen", { code: "KeyF" }, { fullscreen: true }],
  ["a menu that has the focus keeps no letter", { code: "KeyC", target: within("select") }, { next: true }],
  ["typed text means nothing", { code: "Digit1", target: within("textarea") }, null],
  ...["ctrlKey", "metaKey", "altKey", "repeat"].map((how) => [`with ${how} a key means nothing`, { code: "KeyC", [how]: true }, null]),
  ...DRIVING.map((code) => [`${code}, which drives, stops or is any other, means nothing`, { code }, null]),
]) {
  test(`keys: ${what}`, () => assert.deepEqual(viewActionOf({ target: within(), ...event }), action));
}

test("another camera begins with the timestamp of the one before and then answers for itself", () => {
  const timestamp = new MainTimestamp();
  assert.equal(timestamp.read("/a", null), null);
  assert.equal(timestamp.read("/a", 10), 10);
  assert.equal(timestamp.read("/b", null), 10);
  assert.equal(timestamp.read("/b", null), 10);
  assert.equal(timestamp.read("/b", 40), 40);
  assert.equal(timestamp.read("/c", 20), 20, "one that had stalled before is as old as it is");
});

test("the laser in the stick is drawn again also when nothing comes, as its scan grows old", () => {
  let drawn = 0;
  const others = { reportMain() {}, tiles: { each() {} }, smallMap: { showState() {} }, overlays: { show() {} } };
  const view = { ...others, ticks: 0, ring: { draw: () => (drawn += 1) } };
  for (let i = 0; i < 4; i += 1) View.prototype.tick.call(view);
  assert.equal(drawn, 2);
});

function viewOf(driveTopic) {
  const said = [];
  const reader = (name) => ({ follow() {}, forget: () => said.push(name) });
  const choice = new TopicChoice({ named: () => null, driveTopic });
  const parts = { world: reader("world"), overlays: reader("overlays"), choice, known: new Set(), offer() {}, showQuestions() {} };
  return Object.assign(Object.create(View.prototype), { page: {}, hasMap: true, said, ...parts });
}

test("what was read of a topic that is another robot's is forgotten, as is its camera, without which driving is held", () => {
  const view = viewOf("/a/cmd_vel");
  const types = { odom: "nav_msgs/Odometry", diagnostics: "diagnostic_msgs/DiagnosticArray", image_raw: "sensor_msgs/Image" };
  const topics = Object.entries(types).map(([name, type]) => ({ name: `/b/${name}`, type }));
  view.found(topics, true);
  view.found([], false); // of a new link
  assert.deepEqual([view.said, [...view.known]], [[], ["/b/image_raw"]]);
  const others = topics.map(({ name }) => name);
  for (let i = 0; i < 2; i += 1) view.found([], true, others);
  assert.deepEqual([view.said, [...view.known]], [["world", "overlays"], []]);
  assert.equal(view.mayHaveCamera, true, "who drove by it is held");
});

test("which odometry is the robot's is asked also where a laser makes the map", () => {
  const view = viewOf("/cmd_vel");
  const odometry = ["/a/odom", "/b/odom"].map((name) => ({ name, type: "nav_msgs/Odometry" }));
  view.found([...odometry, { name: "/scan", type: "sensor_msgs/LaserScan" }], true);
  assert.match(view.questions.join(), /odometry .*: \/a\/odom or \/b\/odom\?/);
  const many = Array.from({ length: 500 }, (_, i) => ({ name: `/s${i}/scan`, type: "sensor_msgs/LaserScan" }));
  view.found(many, true);
  assert.match(view.questions.join(), /laser scan .*: \/s0\/scan or .* or 496 more\?/);
});

for (const [robot, holds, state] of [
  ["has not said which topics it has", true, { answered: false }],
  ["has said that it has no camera", false, { answered: true }],
  ["has shown a frame", true, { answered: true, known: ["/front"] }],
  ["has a camera in its settings", true, { answered: true, cameras: [{ topic: "/front" }] }],
  ["has settings that say that it has none, as it cannot", false, { answered: false, saysNone: true }],
  ["has one, though its settings say that it has none", true, { answered: false, saysNone: true, known: ["/front"] }],
]) {
  test(`driving ${holds ? "is held without video" : "needs no video"} where a robot ${robot}`, () => {
    const { answered, known = [], cameras = [], saysNone = false } = state;
    const { view, reported } = reporting({ page: { cameras }, known: new Set(known), answered, saysNone });
    view.reportMain();
    assert.deepEqual(reported, [{ offered: holds, at: null }]);
  });
}

// A view that has only what reports its main frame.
function reporting(more) {
  globalThis.document = { hidden: false };
  const reported = [];
  const others = { layout: { shown: [] }, tiles: new Map(), mainTimestamp: new MainTimestamp(), page: {}, known: new Set() };
  const clock = { sleep: { isOver: () => false }, now: () => 0 };
  const view = Object.assign(Object.create(View.prototype), others, clock, { onMain: (reading) => reported.push(reading) }, more);
  return { view, reported };
}

test("what was seen before the machine slept is not reported as seen at any time", () => {
  const tile = { at: 10 };
  const tiles = { get: () => tile, forget: () => (tile.at = null) };
  const { view, reported } = reporting({ layout: { shown: ["/front"], main: "/front" }, tiles });
  view.reportMain();
  view.sleep.isOver = () => true;
  view.reportMain();
  const timestamps = reported.map(({ at }) => at);
  assert.deepEqual(timestamps, [10, null]);
});

// Of a view without a page: what it offers for its places.
function offered({ cameras = [], known = [], hasMap }) {
  const view = Object.create(View.prototype);
  const layout = { offer: (ids) => (view.ids = ids) };
  const parts = { layout, others: [], offerSources() {}, arrange() {} };
  Object.assign(view, { page: { cameras }, known: new Set(known), hasMap, usualIsDown: false, ...parts });
  view.offer();
  view.lacks();
  return view.ids;
}

test("a robot without a camera shows its map, and one whose camera is down goes on showing why", () => {
  assert.deepEqual(offered({ hasMap: true }), [MAP]);
  assert.deepEqual(offered({ hasMap: false }), ["/camera/image_raw"]);
  assert.deepEqual(offered({ hasMap: true, known: ["/front"] }), ["/front", MAP]);
  assert.deepEqual(offered({ hasMap: true, cameras: [{ topic: "/nowhere" }] }), ["/nowhere", MAP]);
});
