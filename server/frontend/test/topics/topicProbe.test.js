import assert from "node:assert/strict";
import { beforeEach, describe, mock, test } from "node:test";

import { part } from "../../src/dom/page.js";
import { numberAt, numbersIn, preview } from "../../src/topics/fields.js";
import { LastMinute, ObserverConnection, TopicProbe } from "../../src/topics/topicProbe.js";
import { TopicSwitch, Uplink, totalText, uplinkRows } from "../../src/topics/uplink.js";
import { FakeElement, FakeLink, settle } from "../fakes.js";

let clock, watched, probe;

const open = () => watched.filter(({ ended }) => !ended).map(({ spec }) => spec.throttleMs);

function make(type) {
  probe = new TopicProbe({
    topic: { name: "/x", type },
    now: () => clock,
    watch: (spec, onMessage, onState) => {
      const watcher = { spec, onMessage, onState, ended: false };
      watched.push(watcher);
      return () => (watcher.ended = true);
    },
  });
}

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  clock = 0;
  watched = [];
  make("nav_msgs/Odometry");
});

const messages = (count, nth = 0) => Array.from({ length: count }, () => watched[nth].onMessage({ v: 1 }));

test("the newest message that cannot be read is said to be so, until one can", () => {
  watched[0].spec.onUnread();
  assert.deepEqual([probe.unread, probe.message, probe.pace.kind], [true, null, "none"]);
  watched[0].onMessage({ x: 1 });
  assert.equal(probe.unread, false);
});

test("a frame is asked for only when the person says so, and one at a time", () => {
  watched = [];
  make("sensor_msgs/msg/Image");
  assert.deepEqual(open(), []);
  probe.getOne();
  probe.getOne();
  assert.deepEqual(open(), [60_000]);
  watched[0].onMessage({ data: "x".repeat(1000) });
  clock = 9000;
  assert.deepEqual([open(), probe.size > 1000, probe.pace.kind], [[], true, "none"], "its silence is the page's own");
  probe.getOne();
  watched[1].spec.onUnread();
  assert.deepEqual([open(), probe.unread], [[], true]);
  probe.getOne();
  watched[2].spec.onRefused("cannot subscribe: too many");
  assert.deepEqual([open(), probe.refusal], [[], "cannot subscribe: too many"]);
});

test("what turns out to be large is followed no more", () => {
  watched[0].onMessage({ poses: "x".repeat(2 ** 20 - 12) });
  assert.deepEqual([open(), probe.large], [[500], false]);
  watched[0].onMessage({ poses: "x".repeat(2 ** 20) });
  assert.deepEqual([open(), probe.large, probe.message.poses.length], [[], true, 2 ** 20]);
});

// A late timer measures for longer, and no higher rate.
for (const seconds of [3, 6]) {
  test(`measuring takes every message for ${seconds} s and no longer`, () => {
    watched[0].onState("open");
    probe.measure();
    probe.measure();
    assert.deepEqual([open(), probe.pace.kind], [[500, 0], "measuring"]);
    messages(10 * seconds, 1);
    clock = 1000 * seconds;
    mock.timers.tick(3000);
    clock += 2000;
    assert.deepEqual([probe.pace, open()], [{ kind: "measured", perSecond: 10, seconds: 2 }, [500]]);
    messages(1);
    clock += 6000;
    assert.deepEqual(probe.pace, { kind: "slow", seconds: 6 }, "what was measured is no longer so");
  });
}

// The pace that is said after messages that came every so many ms, and a while without any.
for (const [name, periodMs, silenceMs, pace] of [
  ["a throttled topic is at least so fast", 500, 0, { kind: "least", perSecond: 2 }],
  ["one that is silent is slow", 500, 9000, { kind: "slow", seconds: 9 }],
  ["a slow topic has its rate", 1000, 0, { kind: "rate", perSecond: 1 }],
]) {
  test(name, () => {
    for (clock = 0; clock <= 5000; clock += periodMs) messages(1);
    clock += silenceMs - periodMs;
    assert.deepEqual(probe.pace, pace);
  });
}

test("a refusal stays until a message comes, whatever the connection does", () => {
  watched[0].spec.onRefused("cannot subscribe to /x");
  watched[0].onState("lost");
  assert.deepEqual([probe.state, probe.refusal], ["refused", "cannot subscribe to /x"]);
  watched[0].onMessage({ v: 1 });
  assert.equal(probe.state, "open");
});

test("its end ends all that it asked for", () => {
  watched[0].onState("open");
  probe.measure();
  probe.end();
  assert.deepEqual(open(), []);
});

// The extent of the last minute at the time of the last value, or later; the values come a second apart.
for (const [name, values, laterMs, extent] of [
  ["nothing of before the last minute is kept", [...Array(91).keys()], 0, { now: 90, min: 30, max: 90 }],
  ["a minute later nothing is", [1, 2], 60_001, null],
  ["what is not a number is no point", [NaN, Infinity], 0, null],
  ["a number that is not known any more is a gap", [1, NaN, 3, NaN], 0, { now: null, min: 1, max: 3 }],
]) {
  test(name, () => {
    const samples = new LastMinute();
    values.forEach((value, second) => samples.push(value, 1000 * second));
    assert.deepEqual(samples.extent(1000 * (values.length - 1) + laterMs), extent);
  });
}

test("while nothing comes, as on a page in the background, the plot has a gap, and no value of now", () => {
  watched[0].onState("open");
  probe.plot("v");
  watched[0].onMessage({ v: 1 });
  watched[0].onState("lost");
  clock = 9000;
  assert.deepEqual([probe.samples.extent(clock).now, probe.pace.kind], [null, "none"], "nor is the topic slow");
  watched[0].onState("open");
  watched[0].onMessage({ v: 3 });
  assert.deepEqual(
    probe.samples.points.map(({ value }) => value),
    [1, null, 3],
  );
});

test("however fast they come, a bounded number of points is kept", () => {
  const samples = new LastMinute();
  for (let i = 0; i < 5000; i++) samples.push(i, i);
  assert.equal(samples.points.length, 600);
});

const SPEC = { name: "/odom", type: "nav_msgs/Odometry", throttleMs: 500 };

let links, urls, states, observerConnection;

beforeEach(() => {
  links = FakeLink.opened = [];
  [urls, states] = [0, []];
  observerConnection = new ObserverConnection({ requestUrl: async () => `wss://server/ros?ticket=${++urls}`, open: FakeLink.open });
});

async function watch() {
  const end = observerConnection.watch(SPEC, Object, (state) => states.push(state));
  await settle();
  return end;
}

async function watchLive() {
  observerConnection.use(true);
  await watch();
  await goLive(0);
}

async function goLive(nth) {
  links[nth].onOpen();
  await settle();
}

test("there is no connection unless something is looked at, and none without a way to the robot", async () => {
  observerConnection.use(true);
  await settle();
  assert.equal(links.length, 0);
  observerConnection.use(false);
  await watch();
  assert.equal(links.length, 0);
  observerConnection.use(true);
  await settle();
  assert.equal(links.length, 1);
});

test("a hidden page and a cut end the connection, and a new one takes up what was looked at", async () => {
  await watchLive();
  observerConnection.use(false);
  assert.equal(links[0].closed, true);
  observerConnection.use(true);
  await settle();
  await goLive(1);
  assert.equal(links[1].subscribed.join(), "/odom");
  assert.notEqual(links[0].url, links[1].url);
  links[1].onClose({ code: 4505 });
  assert.deepEqual(states, ["open", "lost", "open", "lost"]);
});

test("a message that is too large ends what is looked at, and is not asked for again", async () => {
  await watchLive();
  links[0].onClose({ code: 1009 });
  mock.timers.tick(60_000);
  await settle();
  assert.equal(links.length, 1);
  assert.deepEqual(states, ["open", "too_big"]);
  await watch();
  assert.equal(links.length, 2);
});

test("what is closed while the ticket is on its way opens nothing", async () => {
  observerConnection.use(true);
  observerConnection.watch(SPEC, Object, Object)();
  await settle();
  assert.equal(links.length, 0);
});

test("a topic that is silent ends nothing", async () => {
  await watchLive();
  observerConnection.connection.now = () => performance.now() + 600_000;
  mock.timers.tick(1000);
  await settle();
  assert.deepEqual([links.length, states], [1, ["open"]]);
});

test("it counts as one that watches the robot for as long as something is watched", async () => {
  observerConnection.use(true);
  assert.equal(observerConnection.live, false);
  const end = await watch();
  links[0].onOpen();
  await settle();
  assert.equal(observerConnection.live, true);
  end();
  assert.equal(observerConnection.live, false);
});

const ODOMETRY = {
  header: { stamp: { sec: 12, nanosec: 5 }, frame_id: "odom" },
  twist: { twist: { linear: { x: 0.5 } }, covariance: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10] },
  moving: true,
};

for (const [path, number] of [
  ["twist.twist.linear.x", 0.5],
  ["twist.covariance[3]", 4],
  ["moving", 1],
  ["pose.x", NaN],
  ["header.frame_id", NaN],
]) {
  test(`the path ${path} leads to ${number}`, () => assert.equal(numberAt(ODOMETRY, path), number));
}

test("a message with very many numbers offers a bounded choice, and says so", () => {
  const wide = (count) => Object.fromEntries(Array.from({ length: count }, (_, i) => [`joint${i}`, i]));
  const numbers = [wide(200), wide(201), ODOMETRY, { ranges: [1, 2] }].map(numbersIn);
  assert.deepEqual(
    numbers.map(({ paths, isCut }) => [paths.length, isCut]),
    [
      [200, false],
      [200, true],
      [12, true],
      [2, false],
    ],
  );
});

test("long lists, texts and messages are cut, and say so", () => {
  assert.match(preview({ ranges: Array(400).fill(1) }), /^ranges: \[(1, ){15}1, … 384 more\]$/);
  assert.match(preview({ data: "x".repeat(500) }), /x… 340 more characters$/);
  assert.match(preview({ points: Array(9).fill({ x: 1 }) }), /… 5 more$/);
  const long = preview(Object.fromEntries(Array.from({ length: 1000 }, (_, i) => [`n${i}`, i])));
  assert.equal(long.split("\n").length, 201);
  assert.ok(long.endsWith("\n…"));
});

test("what is nested without end is cut as well", () => {
  let deep = { x: 1 };
  for (let i = 0; i < 100; i++) deep = { deep };
  assert.ok(preview(deep).split("\n").length < 20);
  assert.deepEqual(numbersIn(deep), { paths: [], isCut: true });
});

describe("what fills the uplink", () => {
  globalThis.document = { createElement: () => new FakeElement(), addEventListener() {}, hidden: false };

  const MAP = { kind: "topic", name: "/map", bytes_per_s: 118_000, people: 2, yours: true };
  const CAMERA = { kind: "camera", name: "/a", bytes_per_s: 64_000, people: 1, yours: false };
  const REST = { kind: "rosbridge", name: "", bytes_per_s: 300, people: 3, yours: true };

  let root, answer, probes, topicSwitch, list;

  beforeEach(() => {
    mock.timers.reset();
    mock.timers.enable({ apis: ["setTimeout"] });
    root = Object.assign(new FakeElement(), { open: true });
    answer = { ok: true, body: { streams: [MAP, CAMERA, REST], line_bytes_per_s: null } };
    probes = { has: () => false, close: mock.fn() };
    topicSwitch = new TopicSwitch({ subscribe: () => {}, probes });
    list = new Uplink(root, { get: async () => answer, switches: { topic: topicSwitch } });
  });

  // What each row says of its stream.
  const facts = () => part(root, "uplink-list").children.map((row) => part(row, "facts").textContent);

  test("without an answer no number stays on the page", async () => {
    await list.renew();
    answer = { ok: false, detail: "robot sim1 is offline", body: {} };
    await list.renew();
    assert.equal(part(root, "uplink-total").textContent, "Not measured now. Robot sim1 is offline.");
    assert.deepEqual(facts(), ["Topic · ? B/s", "Camera · ? B/s", "? B/s"]);
  });

  test("what a recording reads is not said to be read by nobody", async () => {
    const streams = [{ people: 0 }, { people: 0, recorded: true }, { people: 1, yours: true, recorded: true }].map((readers, i) => ({
      ...CAMERA,
      name: `/${i}`,
      ...readers,
    }));
    answer = { ok: true, body: { streams: [MAP, ...streams], line_bytes_per_s: null } };
    await list.renew();
    const readers = facts().map((words) => words.split(" · ")[2]);
    assert.deepEqual(readers, ["you and 1 more", "nobody now", "only the recording", "you and the recording"]);
  });

  test("a rate that is not measured makes the sum unknown, and a full line is said to be", () => {
    assert.equal(totalText([MAP, { ...CAMERA, bytes_per_s: null }], null), "In all ? B/s.");
    const full = "In all 118 KB/s. The robot's line is full: it carries about 120 KB/s of video and topics.";
    assert.equal(totalText([MAP], 120_400), full);
  });

  test("a probe that a person opened is closed, and is not waited for", () => {
    probes.has = (name) => name === "/scan";
    const [{ offers }] = uplinkRows([{ ...MAP, name: "/scan" }], { topic: topicSwitch });
    assert.equal(offers, "off");
    topicSwitch.switchTo("/scan", false);
    assert.deepEqual([probes.close.mock.calls[0].arguments, topicSwitch.off.size], [["/scan"], 0]);
  });
});
