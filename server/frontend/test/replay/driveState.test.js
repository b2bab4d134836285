import assert from "node:assert/strict";
import { test } from "node:test";

import { COMMANDS, DriveState, SEEN_AGES, historyOf } from "../../src/replay/driveState.js";
import { drawnTopics } from "../../src/replay/mapOfDrive.js";
import { share } from "../../src/replay/timeline.js";

const CONTROL = { online: true, driver: "ann", stopped: false, stopped_by: "", stop_confirmed: false };
const COMMAND = { speed_m_s: 0.5, turn_rad_s: NaN, age_ms: 41.6, outcome: "too_old" };

test("what a recording does not have is not recorded, and so is what is old", () => {
  const state = new DriveState();
  const unknown = state.words(1000, null);
  assert.deepEqual(new Set(Object.values(unknown)), new Set(["not recorded"]));
  state.receive(COMMANDS, COMMAND, 1000);
  const now = state.words(1200, CONTROL);
  assert.deepEqual([now.asked, now.outcome, now["command-age"], now.driver], ["0.50 m/s", "not sent: too old", "42 ms", "ann"]);
  const later = state.words(4000, CONTROL);
  assert.deepEqual([later.asked, later.outcome, later["command-age"]], ["No command", "No command", "not recorded"]);
  const gap = state.words(4000, null);
  assert.deepEqual([gap.asked, gap.driver, gap.state], ["not recorded", "not recorded", "not recorded"]);
});

test("a speed of which one part is not known is none", () => {
  const state = new DriveState();
  for (const [forward, left, words] of [
    [0.3, 0.4, "0.50 m/s"],
    [-0.3, 0, "-0.30 m/s"],
    [0, null, "not recorded"],
  ]) {
    state.receive("measured", { forward, left, turn: null }, 0);
    assert.equal(state.words(100, CONTROL).measured, words);
  }
});

test("one age that nobody knows makes what the driver saw unknown", () => {
  const state = new DriveState();
  for (const [ages, slowed, words] of [
    [[80, 120], { slowed_s: 0.5, max_speed_m_s: 0.3, max_turn_rad_s: NaN }, ["120 ms", "slowed to 0.30 m/s"]],
    [[80, NaN], { slowed_s: 0 }, ["not recorded", "not slowed"]],
    [[], { slowed_s: NaN }, ["not recorded", "not recorded"]],
    [undefined, {}, ["not recorded", "not recorded"]],
  ]) {
    state.receive(SEEN_AGES, { ages_ms: ages, ...slowed }, 0);
    const { "seen-age": seen, limit } = state.words(100, CONTROL);
    assert.deepEqual([seen, limit], words);
  }
});

const RECORDED = [
  { fromMs: 0, toMs: 3000 },
  { fromMs: 3500, toMs: 5000 },
];
const STOPS = [
  { fromMs: 2000, toMs: 2500 },
  { fromMs: 2500, toMs: 3000 },
  { fromMs: 3500, toMs: 4000 },
];

test("events are what changed, and markup in a name stays a text", () => {
  const markup = "<img src=x onerror=alert(1)>";
  const controls = [
    { atMs: 0, message: { ...CONTROL, driver: "" } },
    { atMs: 1000, message: CONTROL },
    { atMs: 2000, message: { ...CONTROL, driver: "", stopped: true, stopped_by: markup } },
    { atMs: 2500, message: { ...CONTROL, driver: "", stopped: true, stopped_by: markup, stop_confirmed: true } },
    { atMs: 4000, message: { ...CONTROL, driver: "" } },
  ];
  const { events, stops, drives, isMore } = historyOf(controls, RECORDED);
  const texts = events.map(({ text }) => text);
  assert.deepEqual(texts, ["ann drives", "Nobody drives", `Stopped by ${markup}`, "Stop confirmed by the robot", "Released"]);
  assert.deepEqual([stops, drives, isMore], [STOPS, [{ fromMs: 1000, toMs: 2000 }], false]);
  const many = Array.from({ length: 1000 }, (_, i) => ({ atMs: i, message: { ...CONTROL, stopped: i % 2 === 0 } }));
  assert.deepEqual([historyOf(many, RECORDED).events.length, historyOf(many, RECORDED).isMore], [200, true]);
  const cut = [
    { atMs: 1000, message: { ...CONTROL, stopped: true } },
    { atMs: 1500, message: null },
  ];
  const unknown = historyOf(cut, RECORDED);
  assert.deepEqual([unknown.stops, unknown.isMore], [[{ fromMs: 1000, toMs: 1500 }], true], "from there on nobody knows");
});

test("nothing of another robot is drawn, also where the robot has none of its own", () => {
  const scan = { name: "/robot1/scan", type: "sensor_msgs/msg/LaserScan" };
  const odometry = { name: "/robot2/odom", type: "nav_msgs/msg/Odometry" };
  const topics = [scan, { ...odometry, name: "/robot1/odom" }, odometry, { name: "/robot1/cmd_vel", type: "geometry_msgs/msg/Twist" }];
  const { scan: drawn, speed } = drawnTopics(topics, "/robot2/cmd_vel");
  assert.deepEqual([drawn, speed], [undefined, odometry]);
});

test("no span leaves the line", () => {
  assert.deepEqual(share({ fromMs: 250, toMs: 500 }, 1000), { from: 0.25, width: 0.25 });
  assert.deepEqual(share({ fromMs: -1e12, toMs: 1e18 }, 1000), { from: 0, width: 1 });
  assert.deepEqual(share({ fromMs: 0, toMs: 0 }, 0), { from: 0, width: 0 });
});
