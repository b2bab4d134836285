import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { KeyFrameMissingError } from "../../src/decoders/streamDecoder.js";
import { part } from "../../src/dom/page.js";
import { COMMANDS, DriveState, SEEN_AGES, historyOf, knownControl } from "../../src/replay/driveState.js";
import { drawnTopics } from "../../src/replay/mapOfDrive.js";
import { ReplayVideo, camerasOf, frameOf } from "../../src/replay/replayVideo.js";
import { share } from "../../src/replay/timeline.js";
import { FakeElement, settle } from "../fakes.js";

let shown, decoded, element, video, fails;

const frame = (atMs, codec = "h264", isKey = false) => ({ codec, isKey, data: Uint8Array.from([1]), atMs });
const words = (atMs, loading = false) => {
  video.show(atMs, { isRecorded: true, loading });
  return part(element, "words").textContent;
};

beforeEach(() => {
  shown = [];
  decoded = [];
  fails = () => null;
  element = new FakeElement();
  video = new ReplayVideo(element, {
    painter: { show: (image) => shown.push(image.atMs) },
    makeDecoder: () => ({
      close() {},
      async decode({ atMs }) {
        decoded.push(atMs);
        const error = fails(atMs);
        if (error) throw error;
        return { atMs, close() {} };
      },
    }),
  });
});

test("a seek decodes from the key frame on and shows the last frame alone", async () => {
  video.reset([frame(0, "h264", true), frame(100), frame(200)]);
  await settle();
  assert.deepEqual([decoded, shown], [[0, 100, 200], [200]]);
  assert.deepEqual([words(300), element.dataset.frame], ["", "live"]);
});

test("of JPEG only what is shown is decoded", async () => {
  video.push([frame(0, "jpeg", true), frame(100, "jpeg", true), frame(200, "jpeg", true)]);
  await settle();
  assert.deepEqual(decoded, [200]);
});

test("a frame that does not decode leaves no older picture, and the next one may", async () => {
  fails = (atMs) => (atMs === 100 ? new Error("no video") : null);
  video.push([frame(0, "jpeg", true)]);
  await settle();
  video.push([frame(100, "jpeg", true)]);
  await settle();
  assert.deepEqual([words(150), element.dataset.frame], ["This browser cannot decode the video here.", "none"]);
  video.push([frame(200, "jpeg", true)]);
  await settle();
  assert.deepEqual([words(250), shown], ["", [0, 200]]);
});

test("where no video is recorded no video is shown", async () => {
  video.push([frame(0, "jpeg", true)]);
  await settle();
  assert.deepEqual([words(1000), words(5000), element.dataset.frame], ["", "No video is recorded here.", "none"]);
  assert.equal(words(5000, true), "Loading.");
  fails = () => new KeyFrameMissingError();
  video.push([frame(6000)]);
  await settle();
  assert.equal(words(6000), "The video starts at the next key frame.");
});

test("cameras are what the recorder wrote of one, in the drive page's order", () => {
  const image = "sensor_msgs/msg/CompressedImage";
  const topics = [
    { name: "/rear/compressed", type: image },
    { name: "/front/compressed", type: image },
    { name: "/front/video", type: "foxglove_msgs/msg/CompressedVideo" },
    { name: "/<script>/compressed", type: image },
    { name: "/odom/compressed", type: "nav_msgs/msg/Odometry" },
    { name: "/video", type: "foxglove_msgs/msg/CompressedVideo" },
  ];
  const cameras = (order) => camerasOf(topics, order).map(({ name, topics }) => `${name}: ${topics.length}`);
  assert.deepEqual(cameras([]), ["/<script>: 1", "/front: 2", "/rear: 1"]);
  assert.deepEqual(cameras(["/rear", "/gone", "/front"]), ["/rear: 1", "/front: 2", "/<script>: 1"]);
  for (const message of [null, {}, { format: "jpeg", data: "text" }, { format: "av1", data: new Uint8Array(2) }]) {
    assert.equal(frameOf(message, 0), null);
  }
});

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
    { atMs: 1500, message: knownControl({ ...CONTROL, fence: -1 }) },
    { atMs: 1800, message: { ...CONTROL, stopped: true } },
    { atMs: 1900, message: null, isMore: true },
  ];
  const unknown = historyOf(cut, RECORDED);
  assert.deepEqual(
    unknown.events.map(({ text }) => text).filter((text) => text !== "ann drives"),
    ["Stopped", "From here on it is not recorded who drives", "Stopped"],
  );
  const known = [1000, 1800].map((atMs) => ({ fromMs: atMs, toMs: atMs === 1000 ? 1500 : 1900 }));
  assert.deepEqual([unknown.stops, unknown.isMore], [known, true], "from there on nobody knows");
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
