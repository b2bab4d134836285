import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { LastMinute, Rate, TopicProbe } from "../../src/topics/topicProbe.js";

let clock, watched;

beforeEach(() => {
  mock.timers.enable({ apis: ["setTimeout"] });
  clock = 0;
  watched = [];
});

afterEach(() => mock.timers.reset());

function probe(type) {
  return new TopicProbe({
    topic: { name: "/x", type },
    now: () => clock,
    watch: (spec, onMessage, onState) => {
      const one = { spec, onMessage, onState, ended: false };
      watched.push(one);
      return () => (one.ended = true);
    },
  });
}

const open = () => watched.filter(({ ended }) => !ended);

test("a topic is asked for twice a second at most", () => {
  probe("nav_msgs/Odometry");
  assert.deepEqual(
    watched.map(({ spec }) => spec.throttleMs),
    [500],
  );
});

test("the newest message that cannot be read is said to be so, until one can", () => {
  const odometry = probe("nav_msgs/Odometry");
  watched[0].spec.onUnread();
  assert.deepEqual([odometry.unread, odometry.message, odometry.pace.kind], [true, null, "none"]);
  watched[0].onMessage({ x: 1 });
  assert.equal(odometry.unread, false);
  const picture = probe("sensor_msgs/msg/Image");
  picture.getOne();
  watched[1].spec.onUnread();
  assert.deepEqual([picture.unread, watched[1].ended], [true, true]);
});

test("a picture is asked for only when the person says so, and one at a time", () => {
  const pictures = probe("sensor_msgs/msg/Image");
  assert.equal(watched.length, 0);
  pictures.getOne();
  pictures.getOne();
  assert.equal(watched.length, 1);
  assert.ok(watched[0].spec.throttleMs > 10_000);
  watched[0].onMessage({ data: "x".repeat(1000) });
  assert.equal(open().length, 0);
  assert.ok(pictures.size > 1000);
  pictures.getOne();
  assert.equal(open().length, 1);
});

test("measuring takes every message for 3 s and no longer", () => {
  const odom = probe("nav_msgs/Odometry");
  watched[0].onState("open");
  odom.measure();
  odom.measure();
  assert.deepEqual(
    open().map(({ spec }) => spec.throttleMs),
    [500, 0],
  );
  for (let i = 0; i < 30; i++) watched[1].onMessage({});
  assert.equal(odom.pace.kind, "measuring");
  clock = 3000;
  mock.timers.tick(3000);
  assert.deepEqual(odom.pace, { kind: "measured", perSecond: 10 });
  assert.deepEqual(
    open().map(({ spec }) => spec.throttleMs),
    [500],
  );
});

test("a late timer measures for longer, and no higher rate", () => {
  const odom = probe("nav_msgs/Odometry");
  watched[0].onState("open");
  odom.measure();
  for (let i = 0; i < 60; i++) watched[1].onMessage({});
  clock = 6000;
  mock.timers.tick(3000);
  assert.deepEqual(odom.pace, { kind: "measured", perSecond: 10 });
});

test("a throttled topic tells no more than that it is at least so fast", () => {
  const odom = probe("nav_msgs/Odometry");
  for (clock = 0; clock <= 5000; clock += 500) watched[0].onMessage({ v: 1 });
  clock -= 500;
  assert.deepEqual(odom.pace, { kind: "least", perSecond: 2 });
  clock += 9000;
  assert.deepEqual(odom.pace, { kind: "slow", seconds: 9 });
});

test("a slow topic tells its rate", () => {
  const battery = probe("sensor_msgs/BatteryState");
  assert.deepEqual(battery.pace, { kind: "none" });
  for (clock = 0; clock <= 4000; clock += 1000) watched[0].onMessage({ v: 1 });
  assert.deepEqual(battery.pace, { kind: "rate", perSecond: 1 });
});

test("a number is plotted from the newest message on", () => {
  const odom = probe("nav_msgs/Odometry");
  watched[0].onMessage({ v: 1 });
  odom.plot("v");
  clock = 500;
  watched[0].onMessage({ v: 3 });
  assert.deepEqual(odom.samples.extent(clock), { now: 3, min: 1, max: 3 });
  odom.plot("");
  assert.equal(odom.samples.extent(clock), null);
});

test("a refusal stays, whatever the connection does afterwards", () => {
  const odom = probe("nav_msgs/Odometry");
  watched[0].spec.onRefused("cannot subscribe to /x");
  watched[0].onState("lost");
  assert.deepEqual([odom.state, odom.refusal], ["refused", "cannot subscribe to /x"]);
});

test("its end ends all that it asked for", () => {
  const odom = probe("nav_msgs/Odometry");
  watched[0].onState("open");
  odom.measure();
  odom.end();
  assert.equal(open().length, 0);
});

test("the last minute is kept, and nothing before it", () => {
  const samples = new LastMinute();
  for (let s = 0; s <= 90; s++) samples.push(s, 1000 * s);
  assert.deepEqual(samples.extent(90_000), { now: 90, min: 30, max: 90 });
  assert.equal(samples.extent(200_000), null);
});

test("what is no number is no point", () => {
  const samples = new LastMinute();
  samples.push(NaN, 0);
  samples.push(Infinity, 0);
  assert.equal(samples.extent(0), null);
});

test("a number that is not known any more is a gap, and not the last one that was", () => {
  const samples = new LastMinute();
  for (const [at, value] of [1, NaN, 3, NaN].entries()) samples.push(value, at);
  assert.deepEqual(samples.extent(4), { now: null, min: 1, max: 3 });
});

test("however fast they come, so many points are kept", () => {
  const samples = new LastMinute();
  for (let i = 0; i < 5000; i++) samples.push(i, i);
  assert.equal(samples.points.length, 600);
});

test("a rate is that of the messages that came of late", () => {
  const rate = new Rate();
  assert.equal(rate.perSecond(0), null);
  assert.equal(rate.silenceMs(0), null);
  for (let at = 0; at <= 20_000; at += 500) rate.mark(at);
  assert.equal(rate.perSecond(20_000), 2);
  assert.equal(rate.silenceMs(26_000), 6000);
  assert.equal(rate.perSecond(40_000), null);
});
