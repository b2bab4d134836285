import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { RttProbe } from "../../src/client/rtt.js";
import { ClockSync, ControlState, Session } from "../../src/client/session.js";

let advertised, ended, published, session;

beforeEach(() => {
  advertised = [];
  ended = 0;
  published = [];
  session = new Session({ driveTopic: "/cmd_vel" });
  session.clockSync.stamp = (timestamp) => ({ t_ms: timestamp + 1000 });
  session.connection.advertise = ({ name, type }) => {
    advertised.push(`${name} ${type}`);
    return { publish: (...what) => published.push(what), end: () => (ended += 1) };
  };
});

test("a page that watches, and one without a drive topic, advertise and publish nothing", () => {
  session.useType("geometry_msgs/Twist");
  for (const driving of [false, true]) {
    session.use(driving);
    session.publish({ forward: 1, turn: 0 }, 5);
    assert.deepEqual([advertised, published], [[], []]);
    session.driveTopic = "";
  }
});

test("a command names the frames that were seen at its input, also before the relay's clock is known", () => {
  const at = [];
  session.seenAt = (timestamp) => (at.push(timestamp), [{ camera: "/a", frame: 41 }]);
  session.useType("geometry_msgs/Twist");
  session.use(true);
  session.publish({ forward: 1, turn: 0 }, 5);
  session.clockSync.stamp = () => undefined;
  session.publish({ forward: 1, turn: 0 }, 6);
  const seen = [{ camera: "/a", frame: 41 }];
  const [[, known], [, unknown]] = published;
  assert.deepEqual([known, unknown, at], [{ t_ms: 1005, seen }, { seen }, [5, 6]]);
});

test("a command waits neither behind old ones nor for a robot that is silent", () => {
  for (const [backlog, silenceMs, mayQueue] of [
    [2000, 1900, true],
    [2100, 0, false],
    [0, 2100, false],
  ]) {
    session.connection = { backlog, silenceMs };
    assert.equal(session.mayQueue, mayQueue);
  }
});

test("the relay alone says how old is what is seen", () => {
  const ages = [];
  session.onSeen = (seen) => ages.push(seen);
  session.clockSync.isRelays = ({ key }) => key === "mine";
  session.receive({ op: "robotether.seen", age_ms: 1, key: "a robot's" });
  session.receive({ op: "robotether.seen", age_ms: 140.2, key: "mine" });
  session.receive({ op: "robotether.seen", age_ms: null, max_speed_m_s: 0.025, max_turn_rad_s: null, key: "mine" });
  assert.deepEqual(ages, [
    { ageMs: 140.2, maxSpeed: null, maxTurn: null },
    { ageMs: null, maxSpeed: 0.025, maxTurn: null },
  ]);
});

test("another type, and another connection, are advertised anew", () => {
  session.use(true);
  session.useType("geometry_msgs/Twist");
  session.useType("geometry_msgs/Twist");
  session.useType("geometry_msgs/TwistStamped");
  assert.deepEqual(advertised, ["/cmd_vel geometry_msgs/Twist", "/cmd_vel geometry_msgs/TwistStamped"]);
  assert.equal(ended, 1);
  session.use(false);
  assert.equal(ended, 2);
});

test("a car's steering follows its wheelbase", () => {
  session.wheelbase = 0.5;
  session.useType("ackermann_msgs/AckermannDriveStamped");
  session.use(true);
  session.publish({ forward: 1, left: 0, turn: 1 }, 5);
  const [[{ drive }]] = published;
  assert.deepEqual(drive, { steering_angle: Math.atan(0.5), speed: 1 });
});

test("the end of the link ends what the relay's clock says, and the events count", () => {
  const controls = [];
  session.controlState.onControl = (control) => controls.push(control);
  session.clockSync.stop = () => controls.push("no clock");
  session.controlState.fromLink("a");
  session.connection.handlers.onLink(null);
  session.controlState.fromFeed("b");
  assert.deepEqual(controls, ["a", "no clock", "b"]);
});

let heard, heardAt, state;

beforeEach(() => {
  heard = [];
  heardAt = 0;
  state = new ControlState({ onControl: (control) => heard.push(control), now: () => heardAt });
});

const link = (...controls) => controls.forEach((control) => state.fromLink(control));
const feed = (...controls) => controls.forEach((control) => state.fromFeed(control));

// What is heard of the control, by what connection and events report.
for (const [name, act, expected] of [
  ["the events count while the connection has reported nothing", () => [feed("a"), link("b")], ["a", "b"]],
  ["while the connection tells, older news of the events change nothing", () => [link("a"), feed("late")], ["a"]],
  ["the events' last report counts once it has ended", () => [link("a"), feed("b"), state.linkEnded(), feed("c")], ["a", "b", "c"]],
  ["else the connection's own last word stands", () => [link("a"), feed("a, late"), link("b"), state.linkEnded()], ["a", "b"]],
  ["what the events bring late is no news", () => [link("a", "b", "c"), feed("a"), state.linkEnded(), feed("b", "c")], ["a", "b", "c"]],
  ["after a while it is", () => [link("a", "b"), state.linkEnded(), (heardAt = 5000), feed("a")], ["a", "b", "a"]],
  ["what is so again is news", () => [feed("a"), link("a"), state.linkEnded(), feed("b", "a")], ["a", "a", "b", "a"]],
]) {
  test(name, () => {
    act();
    assert.deepEqual(heard, expected);
  });
}

const AHEAD_MS = 5000; // of the relay's clock before this page's

let clock, sent, clockSync;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = 100;
  sent = [];
  clockSync = new ClockSync({ now: () => clock });
  clockSync.start((message) => sent.push(message));
});

// The relay answers at once; the way back takes `back` ms.
function answer(back, more = {}) {
  const relay_ms = clock + AHEAD_MS;
  clock += back;
  clockSync.receive({ relay_ms, ...more });
}

test("a clock sync goes out at once and then every 250 ms, until the connection ends", () => {
  assert.deepEqual(sent, [{ op: "robotether.clock_sync", t_ms: 100, key: sent[0].key }]);
  mock.timers.tick(1000);
  assert.equal(sent.length, 5);
  clockSync.stop();
  mock.timers.tick(1000);
  assert.equal(sent.length, 5);
});

const pass = (ms) => (clock += ms);
const start = () => clockSync.start(() => {});

// By the answers to clock syncs: a timestamp in the relay's time, less by the way back of the answer that came fastest.
for (const [name, act, lessMs] of [
  ["nothing is known before the first answer", () => {}],
  ["nor by one without the relay's time", () => [clockSync.receive({}), clockSync.receive({ relay_ms: "soon" })]],
  ["nor of an earlier connection", () => [answer(10), start()]],
  ["a timestamp is too early by the way back", () => answer(300), 300],
  ["the answer that came fastest counts", () => [answer(300), answer(20), answer(400)], 20],
  ["for 10 s: clocks drift, and a sleep stops one of them", () => [answer(20), pass(9000), answer(80)], 20],
  ["and no longer", () => [answer(20), pass(9000), answer(80), pass(1000)], 80],
  ["then none does", () => [answer(20), pass(9000), answer(80), pass(11_000)]],
]) {
  test(`the relay's clock: ${name}`, () => {
    act();
    assert.equal(clockSync.stamp(1000)?.t_ms, lessMs && 1000 + AHEAD_MS - lessMs);
  });
}

test("the round trip to the relay is the median of the newest answers, and unknown without any", () => {
  assert.equal(clockSync.roundTripMs, null);
  clock += 700;
  assert.equal(clockSync.silenceMs, 700);
  for (const back of [10, 12, 300]) answer(back, { t_ms: clock });
  assert.equal(clockSync.silenceMs, 0);
  assert.equal(clockSync.roundTripMs, 12);
  clockSync.stop();
  assert.equal(clockSync.roundTripMs, null);
});

test("only what has the key of this connection's clock syncs is the relay's: a robot sees none of them", () => {
  const [{ key }] = sent;
  assert.match(key, /^[0-9a-f]{32}$/);
  mock.timers.tick(250);
  assert.equal(sent[1].key, key);
  assert.ok(clockSync.isRelays({ key }));
  clockSync.start((message) => sent.push(message));
  assert.ok(!clockSync.isRelays({ key }), "the key of an earlier connection is none of this one");
  clockSync.stop();
  assert.ok(!clockSync.isRelays({ key: sent.at(-1).key }));
  assert.ok(!clockSync.isRelays({}));
});

test("rosbridge is called each second, also after a failure, and again after five without an answer, which then counts no more", async () => {
  const calls = [];
  let reading;
  const call = () => new Promise((resolve) => calls.push(resolve));
  const probe = new RttProbe({ call, onReading: (value) => (reading = value), now: () => clock });
  const answer = (nth) => [calls[nth]({ ok: false }), new Promise(setImmediate)].at(-1);
  probe.start();
  await answer(0);
  for (let i = 0; i < 6; i++) {
    pass(1000);
    mock.timers.tick(1000);
  }
  await answer(1);
  assert.deepEqual([calls.length, reading], [3, { medianMs: 0, ageMs: 6000 }]);
});
