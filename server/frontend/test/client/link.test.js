import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import { openLink } from "../../src/client/rosbridge.js";

let socket, told, link;
const original = globalThis.WebSocket;

class FakeSocket {
  static CONNECTING = 0;
  static OPEN = 1;
  static CLOSING = 2;
  static CLOSED = 3;
  readyState = FakeSocket.CONNECTING;
  sent = [];

  constructor() {
    socket = this;
  }

  send(text) {
    this.sent.push(JSON.parse(text));
  }

  close() {}
}

beforeEach(async () => {
  globalThis.WebSocket = FakeSocket;
  told = { robot: [], relay: [], opened: 0 };
  link = openLink("wss://server/ros", {
    onOpen: () => (told.opened += 1),
    onMessage: (message) => told.robot.push(message.op),
    onOwn: (message) => told.relay.push(message),
    onClose: () => {},
  });
  for (let i = 0; i < 5; i++) await Promise.resolve(); // roslib waits for its transport
});

afterEach(() => {
  globalThis.WebSocket = original;
});

function open() {
  socket.readyState = FakeSocket.OPEN;
  socket.onopen({});
}

const receive = (message) => socket.onmessage({ data: JSON.stringify(message) });

test("operations of our own reach their handler and not roslib's", () => {
  open();
  assert.equal(told.opened, 1);
  receive({ op: "robotether.control", control: { driver: null } });
  receive({ op: "status", level: "error", msg: "cannot publish to /x" });
  assert.deepEqual(told.relay, [{ op: "robotether.control", control: { driver: null } }]);
  assert.deepEqual(told.robot, ["status"]);
});

test("what is no message of rosbridge ends nothing", () => {
  open();
  socket.onmessage({ data: "{" });
  socket.onmessage({ data: "null" });
  socket.onmessage({ data: new ArrayBuffer(1) });
  receive({ op: 5 });
  assert.deepEqual(told.robot, []);
});

test("an operation of our own is sent now or never", () => {
  assert.equal(link.send({ op: "robotether.stop" }), false);
  open();
  assert.deepEqual(socket.sent, []);
  assert.equal(link.send({ op: "robotether.stop" }), true);
  assert.deepEqual(socket.sent, [{ op: "robotether.stop" }]);
  socket.readyState = FakeSocket.CLOSING;
  assert.equal(link.send({ op: "robotether.stop" }), false);
});

test("a command carries its moment beside the message", () => {
  open();
  const channel = link.advertise({ name: "/cmd_vel", type: "geometry_msgs/Twist" });
  channel.publish({ linear: {} }, { t_ms: 5 });
  channel.publish({ linear: {} }, undefined);
  const [advertise, ...published] = socket.sent;
  assert.equal(advertise.op, "advertise");
  assert.deepEqual(published, [
    { op: "publish", topic: "/cmd_vel", msg: { linear: {} }, robotether: { t_ms: 5 } },
    { op: "publish", topic: "/cmd_vel", msg: { linear: {} } },
  ]);
});

test("who publishes hears of a message that the server refuses", () => {
  open();
  const refused = [];
  const channel = link.advertise({
    name: "/lights",
    type: "std_msgs/Bool",
    onRefused: (why) => refused.push(why),
  });
  channel.publish({ data: true });
  const { id } = socket.sent.at(-1);
  receive({ op: "status", level: "error", id: "another", msg: "cannot publish to /arm" });
  receive({ op: "status", level: "warning", id, msg: "slow" });
  receive({ op: "status", level: "error", id, msg: "cannot publish to /lights" });
  assert.deepEqual(refused, ["cannot publish to /lights"]);
});

test("a call settles with the robot's answer, whatever that is, and with the server's refusal", async () => {
  open();
  const calls = ["/dock", "/lift", "/arm"].map((name) => link.call(name, { a: 1 }, "std_srvs/Trigger"));
  const [dock, lift, arm] = socket.sent;
  assert.deepEqual(dock, {
    op: "call_service",
    id: dock.id,
    service: "/dock",
    type: "std_srvs/Trigger",
    args: { a: 1 },
  });
  receive({ op: "status", level: "error", id: arm.id, msg: "cannot call /arm" });
  receive({ op: "service_response", id: lift.id, service: "/lift", result: false, values: "no such service" });
  receive({ op: "service_response", id: dock.id, service: "/dock", result: true, values: { success: true } });
  assert.deepEqual(await Promise.all(calls), [
    { ok: true, values: { success: true } },
    { ok: false, values: "no such service" },
    { ok: false, values: "cannot call /arm" },
  ]);
});

test("who subscribes hears when the server refuses that", () => {
  open();
  const refused = [];
  const spec = { name: "/odom", type: "nav_msgs/Odometry", throttleMs: 500, onRefused: (why) => refused.push(why) };
  const { end } = link.subscribe(spec, () => {});
  const [{ id, throttle_rate, queue_length }] = socket.sent;
  assert.deepEqual([throttle_rate, queue_length], [500, 1]);
  receive({ op: "status", level: "error", id, msg: "cannot subscribe to /odom" });
  assert.deepEqual(refused, ["cannot subscribe to /odom"]);
  end();
  assert.equal(socket.sent.at(-1).op, "unsubscribe");
});
