import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { Feed, EventReader } from "../../src/client/feed.js";
import { settle } from "../fakes.js";

let answers, states, heard, feed;

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
  mock.timers.enable({ apis: ["setTimeout"] });
  [answers, states, heard] = [[], [], []];
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
  mock.timers.tick(ms);
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

test("comments keep a quiet stream alive, and one that says nothing for 25 s is lost", async () => {
  const stream = nextAnswer();
  feed.start();
  stream.send("fleet", []);
  for (let i = 0; i < 10; i++) {
    await pass(10_000);
    stream.write(": awake\n\n");
    await settle();
  }
  await pass(24_999);
  assert.deepEqual([states.at(-1), fetch.mock.callCount()], ["live", 1]);
  await pass(1);
  assert.equal(states.at(-1), "lost");
  assert.equal(fetch.mock.calls[0].arguments[1].signal.aborted, true);
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
