import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { driveMessage, openLink, parse } from "../../src/client/rosbridge.js";
import { FakeWebSocket } from "../fakes.js";

let socket, told, link;

globalThis.WebSocket = FakeWebSocket;

beforeEach(() => {
  told = { robot: [], relay: [], opened: 0 };
  link = openLink("wss://server/ros", {
    onOpen: () => (told.opened += 1),
    onMessage: (message) => told.robot.push(message.op),
    onOwn: (message) => told.relay.push(message),
    onClose: () => {},
  });
  socket = link.socket;
});

const open = () => socket.open();
const receive = (message) => socket.tell(message);

test("what is not a message of rosbridge ends nothing", () => {
  open();
  for (const data of ["{", "null", new ArrayBuffer(1)]) socket.onmessage({ data });
  receive({ op: 5 });
  assert.deepEqual(told.robot, []);
});

test("a message that cannot be read is no value, and each subscriber of its topic is notified", () => {
  open();
  const [values, unread] = [[], []];
  const follow = (name) =>
    link.subscribe({ name, type: "nav_msgs/Odometry", onUnread: () => unread.push(name) }, (message) => values.push(message));
  follow("/odom");
  follow("/map");
  for (const msg of ['{"x": nan}', '{"x": "cut o', "5", "null", '"text"']) {
    socket.onmessage({ data: `{"op": "publish", "topic": "/odom", "msg": ${msg}}` });
  }
  socket.onmessage({ data: '{"op": "publish", "topic": "/other", "msg": {' });
  socket.onmessage({ data: '{"op": "publish", "topic": "/map", "msg": {"x": NaN}}' });
  assert.deepEqual([values, unread], [[{ x: null }], Array(5).fill("/odom")]);
});

test("a call whose answer cannot be read has failed, and nobody waits for it", async () => {
  open();
  const answer = link.call("/dock", {});
  const { id } = socket.sent.at(-1);
  socket.onmessage({ data: `{"op": "service_response", "id": "${id}", "values": {"topic": "/odom", "x": nan}, "result": true}` });
  assert.deepEqual(await answer, { ok: false, values: "its answer cannot be read" });
});

test("who publishes or subscribes hears when the server refuses that", () => {
  open();
  const refused = [];
  const spec = { name: "/lights", type: "std_msgs/Bool", onRefused: (why) => refused.push(why) };
  for (const act of [() => link.advertise(spec).publish({ data: true }), () => link.subscribe(spec, () => {})]) {
    act();
    const { id } = socket.sent.at(-1);
    receive({ op: "status", level: "error", id: "another", msg: "cannot publish to /arm" });
    receive({ op: "status", level: "warning", id, msg: "slow" });
    receive({ op: "service_response", id, result: false });
    receive({ op: "status", level: "error", id, msg: "refused" });
  }
  assert.deepEqual(refused, ["refused", "refused"]);
});

test("a call settles with the robot's answer, whatever that is, and with the server's refusal", async () => {
  open();
  const calls = ["/dock", "/lift", "/arm"].map((name) => link.call(name, { a: 1 }, "std_srvs/Trigger"));
  const [dock, lift, arm] = socket.sent;
  assert.deepEqual(dock, { op: "call_service", id: dock.id, service: "/dock", type: "std_srvs/Trigger", args: { a: 1 } });
  receive({ op: "status", level: "error", id: arm.id, msg: "cannot call /arm" });
  receive({ op: "service_response", id: lift.id, service: "/lift", result: false, values: "no such service" });
  receive({ op: "service_response", id: dock.id, service: "/dock", result: true, values: { success: true } });
  assert.deepEqual(await Promise.all(calls), [
    { ok: true, values: { success: true } },
    { ok: false, values: "no such service" },
    { ok: false, values: "cannot call /arm" },
  ]);
});

test("subscriptions and publishers are those of rosbridge's protocol", () => {
  open();
  const odom = link.subscribe({ name: "/odom", type: "nav_msgs/Odometry", throttleMs: 500 }, () => {});
  const map = link.subscribe({ name: "/map" }, () => {});
  const drive = link.advertise({ name: "/cmd_vel", type: "geometry_msgs/Twist" });
  for (const one of [odom, map, drive]) one.end();
  const ids = socket.sent.map(({ id }) => id);
  assert.deepEqual(ids, [...ids.slice(0, 3), ...ids.slice(0, 3)]);
  const usual = { op: "subscribe", compression: "none" };
  assert.deepEqual(
    socket.sent.map(({ id, ...message }) => id && message),
    [
      { ...usual, topic: "/odom", type: "nav_msgs/Odometry", throttle_rate: 500, queue_length: 1 },
      { ...usual, topic: "/map", throttle_rate: 0, queue_length: 0 },
      { op: "advertise", topic: "/cmd_vel", type: "geometry_msgs/Twist", latch: false, queue_size: 1 },
      { op: "unsubscribe", topic: "/odom" },
      { op: "unsubscribe", topic: "/map" },
      { op: "unadvertise", topic: "/cmd_vel" },
    ],
  );
});

test("each subscriber of a topic gets its messages until it ends", () => {
  open();
  const got = [];
  const handler = ({ n }) => got.push(n);
  const [first, second] = [link.subscribe({ name: "/odom" }, handler), link.subscribe({ name: "/odom" }, handler)];
  const say = (topic, n) => receive({ op: "publish", topic, msg: { n } });
  say("/odom", 1);
  say("/pose", 2);
  first.end();
  say("/odom", 3);
  second.end();
  say("/odom", 4);
  assert.deepEqual(got, [1, 1, 3]);
});

test("nothing is sent on a socket that is not open yet, closes or is closed, whatever still ends then", () => {
  assert.equal(link.send({ op: "robotether.stop" }), false);
  socket.readyState = FakeWebSocket.OPEN;
  assert.deepEqual([link.send({ op: "robotether.stop" }), socket.sent], [true, [{ op: "robotether.stop" }]]);
  const subscription = link.subscribe({ name: "/odom" }, () => {});
  const channel = link.advertise({ name: "/cmd_vel" });
  const { length } = socket.sent;
  for (const state of [FakeWebSocket.CLOSING, FakeWebSocket.CLOSED]) {
    socket.readyState = state;
    channel.publish({});
    subscription.end();
    channel.end();
    assert.equal(link.send({ op: "robotether.stop" }), false);
  }
  assert.equal(socket.sent.length, length);
});

const car = (twist, wheelbase) => driveMessage("ackermann_msgs/msg/AckermannDriveStamped", twist, { wheelbase }).drive;

test("a car steers so that it follows the twist's curve, forwards and backwards", () => {
  const { speed, steering_angle } = car({ forward: 2, turn: 1 }, 0.5);
  assert.equal(speed, 2);
  assert.ok(Math.abs((2 * Math.tan(steering_angle)) / 0.5 - 1) < 1e-9);
  assert.equal(car({ forward: -2, turn: -1 }, 0.5).steering_angle, steering_angle);
  assert.equal(car({ forward: 2, turn: -1 }, 0.5).steering_angle, -steering_angle);
});

test("a car that stands points its wheels ahead, and one of unknown size steers all the same", () => {
  assert.deepEqual(car({ forward: 0, left: 0, turn: 1 }, 0.5), { steering_angle: 0, speed: 0 });
  assert.ok(car({ forward: 1, turn: 1 }, null).steering_angle > 0);
});

test("numbers that are none are read as rosbridge writes them, and texts stay as they are", () => {
  const text = '{"data": [NaN, -Infinity, Infinity, 1.5, null], "text": "NaN, \\"Infinity\\" and -Infinity"}';
  assert.deepEqual(parse(text), { data: [null, -Infinity, Infinity, 1.5, null], text: 'NaN, "Infinity" and -Infinity' });
  assert.equal(parse('{"data": NaNs}'), null);
  assert.equal(parse("{"), null);
  const image = "A".repeat(1.2e7);
  assert.equal(parse(`{"data": "${image}", "range": NaN}`)?.range, null);
});
