import assert from "node:assert/strict";
import { afterEach, beforeEach, describe, mock, test } from "node:test";

import { EventReader, Feed } from "../../src/client/feed.js";
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

describe("events", () => {
  let answers, states, heard, wall, feed;

  // A stream of events that the test writes, as the server's next answer.
  function nextAnswer() {
    const stream = { write: (text) => stream.to.enqueue(new TextEncoder().encode(text)) };
    const body = new ReadableStream({ start: (controller) => (stream.to = controller) });
    stream.send = (name, data) => stream.write(`event: ${name}\ndata: ${JSON.stringify(data)}\n\n`);
    answers.push(new Response(body));
    return stream;
  }

  beforeEach(() => {
    mock.timers.reset();
    mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
    [answers, states, heard, wall] = [[], [], [], 0];
    mock.method(Date, "now", () => wall);
    globalThis.window = { addEventListener() {} };
    mock.method(globalThis, "fetch", async () => {
      const answer = answers.shift();
      if (!answer) throw new TypeError("no network");
      return answer;
    });
    feed = new Feed({
      onFleet: (robots) => heard.push(["fleet", robots]),
      onRobot: (robot) => heard.push(["robot", robot]),
      onRemoved: ({ name }) => heard.push(["removed", name]),
      onState: (state) => states.push(state),
    });
  });

  afterEach(() => {
    feed.close();
    mock.restoreAll();
  });

  async function pass(ms) {
    for (let left = ms; left > 0; left -= 1000) {
      wall += Math.min(left, 1000);
      mock.timers.tick(Math.min(left, 1000));
    }
    await settle();
  }

  test("each kind of event reaches its handler, and an unknown one none", async () => {
    const stream = nextAnswer();
    feed.start();
    stream.send("fleet", []);
    stream.send("robot", { name: "sim1" });
    stream.send("alive", {});
    stream.send("removed", { name: "sim1" });
    await settle();
    assert.deepEqual(heard, [
      ["fleet", []],
      ["robot", { name: "sim1" }],
      ["removed", "sim1"],
    ]);
    assert.deepEqual([...new Set(states)], ["connecting", "live"]);
  });

  test("a stream that ends is lost, and opened again by the page", async () => {
    const stream = nextAnswer();
    feed.start();
    stream.to.close();
    await settle();
    assert.equal(states.at(-1), "lost");
    nextAnswer().send("fleet", []);
    await pass(500);
    assert.equal(states.at(-1), "live");
  });

  test("comments keep a quiet stream alive, and one that says nothing for 7 s is lost", async () => {
    const stream = nextAnswer();
    feed.start();
    stream.send("fleet", []);
    for (let i = 0; i < 10; i++) {
      await pass(3000);
      stream.write(": awake\n\n");
      await settle();
    }
    await pass(6999);
    assert.deepEqual([states.at(-1), fetch.mock.callCount()], ["live", 1]);
    await pass(1);
    assert.equal(states.at(-1), "lost");
    assert.equal(fetch.mock.calls[0].arguments[1].signal.aborted, true);
  });

  test("after a sleep of the machine a stream is lost at once, though its timers stood still", async () => {
    nextAnswer().send("fleet", []);
    feed.start();
    await settle();
    wall += 3_600_000;
    await pass(1000);
    assert.equal(states.at(-1), "lost");
  });

  test("an ended login ends the attempts and is reported as such", async () => {
    answers.push(new Response("", { status: 401 }));
    feed.start();
    await settle();
    assert.equal(states.at(-1), "login");
    await pass(60_000);
    assert.equal(fetch.mock.callCount(), 1);
  });

  const bytes = (text) => new TextEncoder().encode(text);

  test("events come out whole, however the bytes are cut", () => {
    const reader = new EventReader();
    const stream = bytes('event: robot\ndata: {"name":"söm"}\n\nevent: removed\ndata: {}\n\n');
    const found = [...stream].flatMap((byte) => reader.push(Uint8Array.of(byte)));
    assert.deepEqual(found, [
      { name: "robot", data: '{"name":"söm"}' },
      { name: "removed", data: "{}" },
    ]);
  });
});
