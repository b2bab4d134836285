import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { ObserverConnection } from "../../src/topics/topicProbe.js";
import { settle } from "../fakes.js";

const SPEC = { name: "/odom", type: "nav_msgs/Odometry", throttleMs: 500 };

let links, urls, states, observerConnection;

// A link as rosbridge.js makes it, that lets the test play the server.
function fakeLink(url, handlers) {
  const link = { ...handlers, url, subscribed: [], closed: false, close: () => (link.closed = true) };
  link.subscribe = ({ name }, onMessage) => {
    const one = { name, onMessage };
    link.subscribed.push(one);
    return { end: () => link.subscribed.splice(link.subscribed.indexOf(one), 1) };
  };
  links.push(link);
  return link;
}

beforeEach(() => {
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  links = [];
  urls = 0;
  states = [];
  observerConnection = new ObserverConnection({ requestUrl: async () => `wss://server/ros?ticket=${++urls}`, open: fakeLink });
});

afterEach(() => mock.timers.reset());

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
  assert.equal(links[1].subscribed.map(({ name }) => name).join(), "/odom");
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
