import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { TicketRefused } from "../../src/client/api.js";
import { Connection, GIVE_UP } from "../../src/client/connection.js";

let clock, links, tickets, refusal, states, prepared, senders, own, connection;

// A link as link.js makes it, that notes what it is told and lets the test play the server.
function fakeLink(url, handlers) {
  const link = {
    url,
    ...handlers,
    subscribed: [],
    published: [],
    closed: false,
    backlog: 0,
    subscribe({ name }) {
      link.subscribed.push(name);
      return { end: () => link.subscribed.splice(link.subscribed.indexOf(name), 1) };
    },
    advertise: () => ({ publish: (message) => link.published.push(message), end() {} }),
    call: () => new Promise((resolve) => (link.answer = resolve)),
    send: (operation) => link.told.push(operation) > 0,
    told: [],
    close: (code) => Object.assign(link, { closed: true, code }),
  };
  links.push(link);
  return link;
}

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  clock = tickets = prepared = 0;
  links = [];
  states = [];
  senders = [];
  own = [];
  refusal = null;
  connection = new Connection({
    requestTicket: async () => {
      tickets += 1;
      if (refusal) throw refusal;
      return `wss://server/ros?ticket=${tickets}`;
    },
    openLink: fakeLink,
    prepare: async (call) => {
      await call("/rosapi/topics", {});
      prepared += 1;
    },
    onState: ({ name }) => states.push(name),
    onLink: (send) => senders.push(send),
    onOwn: ({ op }) => own.push(op),
    now: () => clock,
  });
});

afterEach(() => connection.stop());

async function settle() {
  for (let i = 0; i < 10; i++) await Promise.resolve();
}

async function pass(ms) {
  clock += ms;
  mock.timers.tick(ms);
  await settle();
}

async function goLive() {
  await settle();
  links.at(-1).onOpen();
  links.at(-1).answer({ ok: true });
  await settle();
}

test("it is live only when the robot itself has answered", async () => {
  connection.start();
  await settle();
  links[0].onOpen();
  await settle();
  assert.deepEqual(states, ["connecting"]);
  links[0].answer({ ok: false });
  await settle();
  assert.deepEqual(states, ["connecting", "live"]);
  assert.equal(prepared, 1);
});

test("news of the network connect nothing beside an attempt or a live link, nor what was not started or was stopped", async () => {
  connection.retryNow();
  connection.start();
  connection.retryNow();
  await goLive();
  connection.retryNow();
  await settle();
  assert.equal(tickets, 1);
  connection.stop();
  assert.equal(connection.live, false);
  connection.retryNow();
  await settle();
  assert.equal(tickets, 1);
});

test("a robot that is offline is told by the close code, and each attempt has a fresh ticket", async () => {
  connection.start();
  await settle();
  links[0].onOpen();
  assert.equal(connection.waits, false);
  links[0].onClose({ code: 4503, reason: "robot sim1 has been offline since 12:03 UTC" });
  assert.deepEqual(states, ["connecting", "offline"]);
  await pass(500);
  assert.equal(links.length, 2);
  assert.notEqual(links[0].url, links[1].url);
  assert.equal(connection.waits, true);
  await goLive();
  assert.equal(connection.waits, false);
});

test("after a cut it resumes with its subscriptions, also those made meanwhile, but for those that ended", async () => {
  connection.start();
  await goLive();
  connection.subscribe({ name: "/odom" }, () => {});
  connection.subscribe({ name: "/scan" }, () => {})();
  assert.deepEqual(links[0].subscribed, ["/odom"]);
  links[0].onClose({ code: 4505, reason: "" });
  connection.subscribe({ name: "/pose" }, () => {});
  await pass(500);
  await goLive();
  assert.deepEqual(states, ["connecting", "live", "link_lost", "live"]);
  assert.deepEqual(links[1].subscribed, ["/odom", "/pose"]);
});

test("what is published while cut is dropped and never reaches the next link", async () => {
  connection.start();
  await goLive();
  const publisher = connection.advertise({ name: "/cmd_vel", type: "geometry_msgs/Twist" });
  assert.equal(publisher.publish("a"), true);
  links[0].onClose({ code: 1006, reason: "" });
  assert.equal(publisher.publish("b"), false);
  await pass(500);
  assert.equal(publisher.publish("c"), false);
  await goLive();
  publisher.publish("d");
  assert.deepEqual(links[0].published, ["a"]);
  assert.deepEqual(links[1].published, ["d"]);
});

test("a call whose link ends before the answer rejects, on whichever way it ends", async () => {
  connection.start();
  for (const end of [() => links.at(-1).onClose({ code: 1006, reason: "" }), () => connection.reopen(), () => connection.stop()]) {
    await goLive();
    const call = connection.call("/dock");
    end();
    await assert.rejects(call, /cannot call \/dock: the connection ended before the answer/);
    await pass(500);
  }
});

test("silence on a live link is a lost link", async () => {
  connection.start();
  await goLive();
  for (let i = 0; i < 5; i++) await pass(1000);
  links[0].onMessage();
  for (let i = 0; i < 6; i++) await pass(1000);
  assert.equal(states.at(-1), "live");
  clock += 1;
  await pass(1000);
  assert.equal(states.at(-1), "link_lost");
  assert.equal(links[0].closed, true);
});

test("a page in the background, whose timers run once a minute, keeps its link", async () => {
  connection.start();
  await goLive();
  for (let i = 0; i < 3; i++) {
    clock += 59_000;
    await pass(1000);
    assert.equal(states.at(-1), "live");
    links[0].onMessage(); // the answer to what that minute's timer asked
  }
  for (let i = 0; i < 7; i++) await pass(1000);
  assert.equal(states.at(-1), "link_lost");
});

test("a page that gives up control says so by the code with which it closes", async () => {
  connection.start();
  await goLive();
  connection.reopen(GIVE_UP);
  assert.equal(links[0].code, 4000);
  await goLive();
  connection.stop();
  assert.equal(links[1].code, undefined);
});

test("the last that a link carries which the page gives up is what onLeaving says", async () => {
  connection.start();
  await goLive();
  const publisher = connection.advertise({ name: "/cmd_vel", type: "geometry_msgs/Twist" });
  connection.handlers.onLeaving = () => publisher.publish("zero");
  connection.cut();
  assert.deepEqual([states.at(-1), links[0].closed, links[0].published], ["link_lost", true, ["zero"]]);
  connection.cut();
  await pass(500);
  links[1].onOpen();
  links[1].onClose({ code: 4503, reason: "" });
  assert.deepEqual(links[1].published, []);
});

test("after a change of rights the next ticket says what is left", async () => {
  connection.start();
  await goLive();
  links[0].onClose({ code: 4001, reason: "" });
  assert.equal(states.at(-1), "connecting");
  refusal = new TicketRefused(403, "grant_missing");
  await pass(60_000);
  assert.equal(states.at(-1), "not_allowed");
  assert.deepEqual([links.length, tickets], [1, 2]);
});

test("no answer from the robot is told as such and tried again", async () => {
  connection.start();
  await settle();
  links[0].onOpen();
  await pass(8000);
  assert.equal(states.at(-1), "rosbridge_down");
  await pass(500);
  assert.equal(links.length, 2);
});

test("without a server the attempts go on with growing delays", async () => {
  refusal = new TicketRefused(0);
  connection.start();
  await settle();
  assert.equal(states.at(-1), "server_unreachable");
  for (let i = 0; i < 20; i++) await pass(500);
  assert.ok(tickets >= 3 && tickets <= 8, `${tickets} attempts in 10 s`);
  refusal = null;
  for (let i = 0; i < 10; i++) await pass(500);
  await goLive();
  assert.equal(states.at(-1), "live");
});

test("news that the robot is back cuts the wait short", async () => {
  connection.start();
  await settle();
  for (let i = 0; i < 6; i++) {
    links.at(-1).onOpen();
    links.at(-1).onClose({ code: 4503, reason: "" });
    if (i < 5) await pass(5000);
  }
  const before = links.length;
  connection.retryNow();
  await settle();
  assert.equal(links.length, before + 1);
});

for (const code of [4002, 4003, 4009, 4010]) {
  test(`whoever loses the control by ${code} sees on at once`, async () => {
    connection.start();
    await goLive();
    links[0].onClose({ code, reason: "" });
    await pass(0);
    assert.equal(links.length, 2);
    await goLive();
    assert.deepEqual(states, ["connecting", "live", "connecting", "live"]);
  });
}

test("a server that lets nobody drive is not asked over and over", async () => {
  connection.start();
  await settle();
  for (let i = 0; i < 4; i++) {
    links.at(-1).onClose({ code: 4009, reason: "" });
    await pass(0);
  }
  assert.equal(links.length, 2);
});

test("another ticket is asked for as the page drives or watches from now on", async () => {
  connection.start();
  await goLive();
  const live = [];
  connection.handlers.onLink = () => live.push(connection.live);
  connection.reopen();
  assert.deepEqual([links[0].closed, live], [true, [false]]); // whoever hears of its end must not find it live
  await goLive();
  assert.equal(links.length, 2);
  assert.deepEqual(states, ["connecting", "live", "connecting", "live"]);
  links[0].onClose({ code: 1000, reason: "" });
  assert.equal(connection.live, true);
});

test("operations of our own go out on an open link, also before the robot has answered, and never later", async () => {
  assert.equal(connection.send({ op: "robotether.stop" }), false);
  connection.start();
  await settle();
  links[0].onOpen();
  assert.equal(connection.send({ op: "robotether.stop" }), true);
  assert.deepEqual(links[0].told, [{ op: "robotether.stop" }]);
  senders[0]({ op: "robotether.beat" });
  assert.equal(links[0].told.length, 2);
  links[0].onClose({ code: 4505, reason: "" });
  assert.equal(senders[1], null);
  assert.equal(connection.send({ op: "robotether.stop" }), false);
});

test("what the relay says is no sign of life of the robot", async () => {
  connection.start();
  await goLive();
  for (let i = 0; i < 7; i++) {
    links[0].onOwn({ op: "robotether.beat" });
    await pass(1000);
  }
  assert.equal(own.length, 7);
  assert.equal(states.at(-1), "link_lost");
});
