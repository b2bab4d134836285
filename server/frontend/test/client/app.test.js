import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { App } from "../../src/client/index.js";
import { FakeWebSocket, settle } from "../fakes.js";

const TWIST = "geometry_msgs/msg/Twist";
let sockets, asked, app, answers;

class FakeServer extends FakeWebSocket {
  send(text) {
    super.send(text);
    const message = this.sent.at(-1);
    if (answers && message.op === "robotether.clock_sync") this.tell({ ...message, relay_ms: 1 });
  }

  close() {
    this.readyState = FakeWebSocket.CLOSED;
  }
}

beforeEach(() => {
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  sockets = FakeWebSocket.opened = [];
  [asked, answers] = [[], true];
  Object.assign(globalThis, { window: new EventTarget(), location: { origin: "https://lab.example" }, WebSocket: FakeServer });
  globalThis.fetch = async (url, { headers, body }) => {
    asked.push([url, headers.Authorization, JSON.parse(body)]);
    return Response.json({ ticket: "t1" }, { status: 201 });
  };
  app = new App({ server: "https://robots.example", name: "joy", token: "rt_x" });
});

afterEach(() => {
  app.close();
  mock.timers.reset();
});

async function goLive() {
  const connected = app.connect();
  await settle();
  sockets.at(-1).open();
  await connected;
}

test("it connects with a ticket of its own, and offers and takes its topics on each connection", async () => {
  const messages = [];
  app.advertise("stick", TWIST);
  app.subscribe("/pose", "a/B", (message) => messages.push(message));
  assert.equal(app.publish("stick", TWIST, { early: true }), false);
  await goLive();
  assert.throws(() => new App({ name: "a b" }), TypeError);
  assert.deepEqual(asked, [["https://robots.example/api/v1/tickets/app", "Bearer rt_x", { app: "joy" }]]);
  assert.equal(sockets[0].url, "wss://robots.example/apps/joy/ros?ticket=t1");
  sockets[0].end(4505);
  mock.timers.tick(500);
  await settle();
  sockets[1].open();
  await settle();
  for (const socket of sockets) {
    const said = ["advertise", "subscribe"].flatMap((op) => socket.said(op).map(({ topic, type }) => `${topic} ${type}`));
    assert.deepEqual(said, [`/stick ${TWIST}`, "/pose a/B"]);
  }
  assert.equal(app.publish("/stick", TWIST, { linear: { x: 1 } }), true);
  assert.deepEqual(sockets[1].said("publish")[0].msg, { linear: { x: 1 } });
  sockets[1].readyState = FakeWebSocket.CLOSING;
  assert.equal(app.publish("/stick", TWIST, {}), false);
  sockets[1].tell({ op: "publish", topic: "/pose", msg: { x: 2 } });
  assert.deepEqual(messages, [{ x: 2 }]);
});

test("a server that answers no more is left", async () => {
  const now = mock.method(performance, "now", () => time);
  let time = 1000;
  const wait = (seconds) => {
    for (let i = 0; i < seconds; i++) {
      time += 1000;
      mock.timers.tick(1000);
    }
  };
  await goLive();
  wait(10);
  assert.equal(app.connection.live, true);
  answers = false;
  wait(4);
  assert.equal(app.connection.live, false);
  now.mock.restore();
});
