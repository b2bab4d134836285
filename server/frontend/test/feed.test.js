import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Feed } from "../src/feed.js";

let sources, states, heard, apiStatus, feed;

class FakeEventSource {
  constructor(url) {
    this.url = url;
    this.handlers = {};
    this.closed = false;
    sources.push(this);
  }

  addEventListener(name, handler) {
    this.handlers[name] = handler;
  }

  send(name, data) {
    this.handlers[name]({ data: JSON.stringify(data) });
  }

  close() {
    this.closed = true;
  }
}

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  sources = [];
  states = [];
  heard = [];
  apiStatus = 502;
  globalThis.EventSource = FakeEventSource;
  globalThis.window = { addEventListener() {} };
  globalThis.fetch = async () => ({ status: apiStatus });
  feed = new Feed({
    onFleet: (robots) => heard.push(["fleet", robots]),
    onRobot: (robot) => heard.push(["robot", robot]),
    onRemoved: ({ name }) => heard.push(["removed", name]),
    onState: (state) => states.push(state),
  });
  feed.start();
});

const settle = () => new Promise((resolve) => setImmediate(resolve));

test("each kind of event reaches its handler", () => {
  sources[0].send("fleet", []);
  sources[0].send("robot", { name: "sim1" });
  sources[0].send("removed", { name: "sim1" });
  assert.deepEqual(heard, [["fleet", []], ["robot", { name: "sim1" }], ["removed", "sim1"]]);
  assert.deepEqual([...new Set(states)], ["connecting", "live"]);
});

test("after an error it is lost, and opened again by the page", async () => {
  sources[0].onerror();
  await settle();
  assert.equal(states.at(-1), "lost");
  assert.equal(sources[0].closed, true);
  mock.timers.tick(500);
  assert.equal(sources.length, 2);
  sources[1].send("fleet", []);
  assert.equal(states.at(-1), "live");
});

test("an ended login ends the attempts and is told as such", async () => {
  apiStatus = 401;
  sources[0].onerror();
  await settle();
  assert.equal(states.at(-1), "login");
  mock.timers.tick(60_000);
  assert.equal(sources.length, 1);
});
