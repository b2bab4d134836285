import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { ObserverConnection } from "../../src/topics/observerConnection.js";

const SPEC = { name: "/odom", type: "nav_msgs/Odometry", throttleMs: 500 };

let links, urls, states, observerConnection;

// A link as link.js makes it, that lets the test play the server.
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
  mock.timers.enable({ apis: ["setTimeout"] });
  links = [];
  urls = 0;
  states = [];
  observerConnection = new ObserverConnection({ requestUrl: async () => `wss://server/ros?ticket=${++urls}`, openLink: fakeLink });
});

afterEach(() => mock.timers.reset());

const settle = () => new Promise((resolve) => setImmediate(resolve));

async function watch() {
  const end = observerConnection.watch(
    SPEC,
    () => {},
    (state) => states.push(state),
  );
  await settle();
  return end;
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

test("several looks share a connection, which ends with the last", async () => {
  observerConnection.use(true);
  const first = await watch();
  links[0].onOpen();
  const second = await watch();
  assert.equal(links.length, 1);
  assert.equal(links[0].subscribed.length, 2);
  first();
  assert.equal(links[0].closed, false);
  assert.equal(links[0].subscribed.length, 1);
  second();
  assert.equal(links[0].closed, true);
});

test("a hidden page ends the connection, and a new one takes up what was looked at", async () => {
  observerConnection.use(true);
  await watch();
  links[0].onOpen();
  observerConnection.use(false);
  assert.equal(links[0].closed, true);
  observerConnection.use(true);
  await settle();
  links[1].onOpen();
  assert.deepEqual(
    links[1].subscribed.map(({ name }) => name),
    ["/odom"],
  );
  assert.notEqual(links[0].url, links[1].url);
  assert.deepEqual(states, ["open", "lost", "open"]);
});

test("after a cut it comes back, with a pause", async () => {
  observerConnection.use(true);
  await watch();
  links[0].onOpen();
  links[0].onClose({ code: 4505 });
  await settle();
  assert.equal(links.length, 1);
  mock.timers.tick(500);
  await settle();
  assert.equal(links.length, 2);
});

test("a message that is too large ends what is looked at, and is not asked for again", async () => {
  observerConnection.use(true);
  await watch();
  links[0].onOpen();
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
  const end = observerConnection.watch(SPEC, () => {});
  end();
  await settle();
  assert.equal(links.length, 0);
});

test("a refused ticket is asked for again later", async () => {
  let refused = true;
  observerConnection.requestUrl = async () => {
    if (refused) throw new Error("refused");
    return "wss://server/ros";
  };
  observerConnection.use(true);
  await watch();
  refused = false;
  mock.timers.tick(500);
  await settle();
  assert.equal(links.length, 1);
});
