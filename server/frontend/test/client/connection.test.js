import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { TicketRefused } from "../../src/client/api.js";
import { Connection, GIVE_UP, afterClose, afterTicketRefusal } from "../../src/client/connection.js";
import { connection as texts } from "../../src/texts/common.js";
import { FakeLink, settle } from "../fakes.js";

let clock, links, tickets, refusal, states, prepared, senders, own, connection;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  clock = tickets = prepared = 0;
  links = FakeLink.opened = [];
  [states, senders, own, refusal] = [[], [], [], null];
  connection = new Connection({
    requestTicket: async () => {
      tickets += 1;
      if (refusal) throw refusal;
      return `wss://server/ros?ticket=${tickets}`;
    },
    openLink: FakeLink.open,
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

async function pass(ms) {
  clock += ms;
  mock.timers.tick(ms);
  await settle();
}

const newest = () => links.at(-1);
const open = () => void newest().onOpen(); // not waited for: the robot has yet to answer
const end = (code = 1006, reason = "") => newest().onClose({ code, reason });

async function begin() {
  connection.start();
  await settle();
}

async function goLive() {
  await settle();
  open();
  newest().answer({ ok: true });
  await settle();
}

async function live() {
  await begin();
  await goLive();
}

// A second each, in which timers run on time.
async function seconds(count, act = () => {}) {
  for (let i = 0; i < count; i++) {
    act();
    await pass(1000);
  }
}

const answered = () => newest().answer({ ok: true }) ?? settle();
const stopAtNews = () => (connection.onState = () => connection.stop());

// As a page's own function does on a network that hangs.
function stuck() {
  const { requestTicket } = connection;
  connection.requestTicket = () => [new Promise(() => {}), (connection.requestTicket = requestTicket)][0];
  return begin();
}

const unreached = () => [(refusal = new TicketRefused(0)), begin()].at(-1);

// Another ticket is asked for while the first is on its way.
function reopened(first = null) {
  refusal = first;
  connection.start();
  refusal = null;
  connection.reopen();
}

// Whoever loses the control sees on at once.
const ended = (code) => [live, () => end(code), () => pass(0)];
const refuseControl = () => [end(4009), pass(0)].at(-1);
const backWithin = (ms) => () => [(refusal = null), pass(ms)].at(-1);

// The states that are shown, how many links were opened and whether the newest is closed from here.
for (const [name, steps, shown, opened, closed = false] of [
  ["it is not live before the robot itself has answered", [begin, open, settle], "connecting", 1],
  ["a robot that is offline is reported by the close code", [begin, open, () => end(4503)], "connecting offline", 1, true],
  ["no answer from the robot is reported as such", [begin, open, () => pass(8000)], "connecting rosbridge_down", 1, true],
  ["an answer after that makes nothing live", [begin, open, () => pass(8000), answered], "connecting rosbridge_down", 1, true],
  ["that is tried again", [begin, open, () => pass(8000), () => pass(500)], "connecting rosbridge_down", 2],
  ["a socket that does not open is an unreachable server", [begin, () => pass(5000)], "connecting server_unreachable", 1, true],
  ["silence on a live link is a lost link", [live, () => seconds(7)], "connecting live link_lost", 1, true],
  ["what the robot says breaks it", [live, () => seconds(5), () => newest().onMessage(), () => seconds(6)], "connecting live", 1],
  ["news that the network is gone ends a live link at once", [live, () => connection.cut()], "connecting live link_lost", 1, true],
  ["another ticket is asked for", [live, () => connection.reopen(), goLive], "connecting live connecting live", 2],
  ["a ticket of before that opens nothing", [reopened, goLive], "connecting connecting live", 1],
  ["its refusal ends nothing", [() => reopened(new TicketRefused(401)), goLive], "connecting connecting live", 1],
  ["who ends it at the news of a cut is not connected again", [live, stopAtNews, end, () => pass(60_000)], "connecting live", 1, true],
  ["news that the robot is back cuts the wait short", [begin, open, () => end(4503), () => connection.retryNow()], "connecting offline", 2],
  [
    "a server that lets nobody drive is not asked over and over",
    [begin, ...Array(4).fill(refuseControl)],
    "connecting connecting connecting",
    2,
    true,
  ],
  ["without a server the attempts go on", [unreached, backWithin(500), goLive], "connecting server_unreachable live", 1],
  [
    "a ticket that never comes is asked for again",
    [stuck, () => pass(10_000), () => pass(500), goLive],
    "connecting server_unreachable live",
    1,
  ],
  ["without a network news of its end change nothing", [begin, () => connection.cut()], "connecting", 1],
  ...[4002, 4003, 4009, 4010].map((code) => [`after ${code} it sees on`, [...ended(code), goLive], "connecting live connecting live", 2]),
]) {
  test(name, async () => {
    for (const step of steps) await step();
    assert.deepEqual([states.join(" "), links.length, newest().closed], [shown, opened, closed]);
  });
}

test("each attempt has a fresh ticket, and the page waits between them", async () => {
  await begin();
  open();
  assert.equal(connection.waits, false);
  end(4503, "robot sim1 has been offline since 12:03 UTC");
  await pass(500);
  assert.notEqual(links[0].url, links[1].url);
  assert.equal(connection.waits, true);
  await goLive();
  assert.deepEqual([connection.waits, prepared], [false, 1]);
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

test("after a cut it resumes with its subscriptions, also those made meanwhile, except those that ended", async () => {
  await live();
  connection.subscribe({ name: "/odom" }, () => {});
  connection.subscribe({ name: "/scan" }, () => {})();
  assert.deepEqual(links[0].subscribed, ["/odom"]);
  end(4505);
  connection.subscribe({ name: "/pose" }, () => {});
  await pass(500);
  await goLive();
  assert.deepEqual(states, ["connecting", "live", "link_lost", "live"]);
  assert.deepEqual(links[1].subscribed, ["/odom", "/pose"]);
});

test("what is published while cut is dropped and never reaches the next link", async () => {
  await live();
  const publisher = connection.advertise({ name: "/cmd_vel", type: "geometry_msgs/Twist" });
  assert.equal(publisher.publish("a"), true);
  end();
  assert.equal(publisher.publish("b"), false);
  await pass(500);
  assert.equal(publisher.publish("c"), false);
  await goLive();
  publisher.publish("d");
  assert.deepEqual([links[0].published, links[1].published], [["a"], ["d"]]);
});

test("a call whose link ends before the answer rejects, on whichever way it ends", async () => {
  connection.start();
  for (const finish of [end, () => connection.reopen(), () => connection.stop()]) {
    await goLive();
    const call = connection.call("/dock");
    finish();
    await assert.rejects(call, /cannot call \/dock: the connection ended before the answer; it may still run/);
    await pass(500);
  }
});

test("a page in the background, whose timers run once a minute, keeps its link", async () => {
  await live();
  for (let i = 0; i < 3; i++) {
    clock += 59_000;
    await pass(1000);
    assert.equal(states.at(-1), "live");
    newest().onMessage(); // the answer to what that minute's timer asked
  }
  await seconds(7);
  assert.equal(states.at(-1), "link_lost");
});

test("a page that gives up control says so by the code with which it closes", async () => {
  await live();
  connection.reopen(GIVE_UP);
  assert.equal(links[0].code, 4000);
  await goLive();
  connection.stop();
  assert.equal(links[1].code, undefined);
});

test("the last that a link carries which the page gives up is what onLeaving says", async () => {
  await live();
  const publisher = connection.advertise({ name: "/cmd_vel", type: "geometry_msgs/Twist" });
  connection.handlers.onLeaving = () => publisher.publish("zero");
  connection.cut();
  assert.deepEqual(links[0].published, ["zero"]);
  connection.cut();
  await pass(500);
  open();
  end(4503);
  assert.deepEqual(links[1].published, []);
});

test("after a change of rights the next ticket says what is left", async () => {
  await live();
  end(4001);
  assert.equal(states.at(-1), "connecting");
  refusal = new TicketRefused(403, "grant_missing");
  await pass(60_000);
  assert.deepEqual([states.at(-1), links.length, tickets], ["not_allowed", 1, 2]);
});

test("a link that was given up is not live when its end is reported, and ends no other", async () => {
  await live();
  const reports = [];
  connection.handlers.onLink = () => reports.push(connection.live);
  connection.reopen();
  assert.deepEqual([links[0].closed, reports], [true, [false]]);
  await goLive();
  links[0].onClose({ code: 1000, reason: "" });
  assert.equal(connection.live, true);
});

test("operations of our own go out on an open link, also before the robot has answered, and never later", async () => {
  assert.equal(connection.send({ op: "robotether.stop" }), false);
  await begin();
  open();
  assert.equal(connection.send({ op: "robotether.stop" }), true);
  assert.deepEqual(links[0].told, [{ op: "robotether.stop" }]);
  senders[0]({ op: "robotether.clock_sync" });
  assert.equal(links[0].told.length, 2);
  end(4505);
  assert.equal(senders[1], null);
  assert.equal(connection.send({ op: "robotether.stop" }), false);
});

test("what the relay says is no sign of life of the robot", async () => {
  await live();
  await seconds(7, () => newest().onOwn({ op: "robotether.clock_sync" }));
  assert.deepEqual([own.length, states.at(-1)], [7, "link_lost"]);
});

const shown = (code, wasLive = false) => {
  const { name, retry } = afterClose({ code, wasLive });
  assert.ok(name in texts, name);
  return `${name} ${retry ? "retry" : "final"}`;
};

test("each close code of the contract has its own state", () => {
  const states = { connecting: [4001], offline: [4503], rosbridge_down: [4504], lease_unavailable: [4510] };
  Object.assign(states, { link_lost: [1008, 1009, 4408, 4413, 4505], server_unreachable: [1001, 4429] });
  for (const [name, codes] of Object.entries(states)) for (const code of codes) assert.equal(shown(code), `${name} retry`);
  assert.deepEqual([shown(1006, true), shown(1006, false)], ["link_lost retry", "server_unreachable retry"]);
});

test("each way to lose the control is distinguished", () => {
  const lost = [4002, 4003, 4009, 4010, 4505].map((code) => afterClose({ code }).lost);
  assert.deepEqual(lost, ["superseded", "robot_stopped", "lease_held", "lease_lost", undefined]);
});

test("the reason that the server wrote is shown, and what to do beside it", () => {
  for (const code of [1001, 1002, 1008, 1009, 1011, 4408, 4413, 4429, 4504, 4505, 4510]) {
    const { name, reason } = afterClose({ code, reason: "rosbridge on robot sim1 does not answer: its port 9091 is taken" });
    assert.match(texts[name].detail({ reason }), /^Rosbridge on robot sim1 does not answer: its port 9091 is taken\. \S/, code);
    const unsaid = texts[name].detail({ reason: afterClose({ code }).reason });
    assert.ok(unsaid && !unsaid.startsWith("."), code);
  }
});

test("a refused ticket ends the attempts only where another attempt cannot help", () => {
  const verdict = (status, code) => {
    const { name, retry, login } = afterTicketRefusal({ status, code });
    return { name, retry, login: Boolean(login) };
  };
  assert.deepEqual(verdict(401, "login_missing"), { name: "not_allowed", retry: false, login: true });
  assert.deepEqual(verdict(403, "grant_missing"), { name: "not_allowed", retry: false, login: false });
  assert.deepEqual(verdict(400, ""), { name: "not_allowed", retry: false, login: false });
  const { reason } = afterTicketRefusal({ status: 403, code: "grant_missing", detail: "cannot drive robot sim1: your grant is observe" });
  assert.match(reason, /^Your grant is observe\. Reload/);
  for (const status of [0, 429, 500, 502, 503]) {
    assert.deepEqual(verdict(status, ""), { name: "server_unreachable", retry: true, login: false });
  }
});
