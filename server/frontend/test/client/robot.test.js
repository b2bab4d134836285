import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { Robot } from "../../src/client/index.js";
import { FakeWebSocket, JPEG, settle } from "../fakes.js";

let robots, sockets, asked, answers, ticketsGiven, windowHears, stopped;

// A double of the server and a robot behind it, as far as one connection shows them.
class FakeServer extends FakeWebSocket {
  send(text) {
    super.send(text);
    const message = this.sent.at(-1);
    if (message.op === "robotether.clock_sync") this.relaySays({ op: message.op, t_ms: message.t_ms, relay_ms: message.t_ms + 500 });
    if (message.op === "call_service") this.answer(message);
    if (message.op === "robotether.stop" && stopped) this.relaySays({ op: "robotether.control", control: { stopped } });
  }

  // With the key of the newest clock sync, which no robot sees.
  relaySays(message) {
    this.tell({ ...message, key: this.said("robotether.clock_sync").at(-1).key });
  }

  answer({ id, service, args }) {
    const values = service === "/rosapi/topic_type" ? { type: "geometry_msgs/TwistStamped" } : { got: args };
    this.tell({ op: "service_response", id, service, result: service !== "/broken", values });
  }

  close(code = 1000, reason = "") {
    if (this.readyState === 3) return;
    this.readyState = 3;
    this.onclose({ code, reason });
  }
}

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  sockets = FakeWebSocket.opened = [];
  [robots, asked, ticketsGiven] = [[], [], []];
  answers = { "/api/v1/tickets": [201, { ticket: "t1" }] };
  stopped = { by: "ann", at: "2026-01-01T12:03:00Z", confirmed: true };
  windowHears = new EventTarget();
  const quiet = { addEventListener() {} };
  Object.assign(globalThis, { window: windowHears, document: quiet, location: { origin: "https://lab.example" }, WebSocket: FakeServer });
  globalThis.fetch = async (url, { headers, body }) => {
    asked.push({ url, headers, body: body && JSON.parse(body) });
    const [status, answer] = answers[new URL(url).pathname] ?? [404, {}];
    return status === 204 ? new Response(null, { status }) : Response.json(answer, { status });
  };
});

afterEach(() => robots.forEach((robot) => robot.close()));

function make(options = {}) {
  robots.push(new Robot({ server: "https://robots.example", robot: "sim 1", token: "rt_x", ...options }));
  return robots.at(-1);
}

async function goLive(robot = make(), options = {}) {
  const connected = robot.connect(options);
  await settle();
  sockets.at(-1).open();
  await settle();
  return connected;
}

test("it gets a ticket with the token, connects, and drives with each command's timestamp", async () => {
  const robot = await goLive();
  assert.deepEqual(asked[0], {
    url: "https://robots.example/api/v1/tickets",
    headers: { "Content-Type": "application/json", Authorization: "Bearer rt_x" },
    body: { robot: "sim 1", mode: "drive" },
  });
  assert.equal(sockets[0].url, "wss://robots.example/robots/sim%201/ros?ticket=t1");
  assert.equal(robot.driving, true);
  assert.equal(robot.drive({ forward: 0.3, turn: 0.1 }), true);
  const [command] = sockets[0].said("publish");
  assert.equal(command.topic, "/cmd_vel");
  assert.equal(command.msg.twist.linear.x, 0.3);
  assert.ok(Number.isFinite(command.robotether.t_ms));
});

test("the lab's backend gives the tickets, one a connection", async () => {
  const robot = make({ token: null, getTicket: async (wish) => `t${ticketsGiven.push(wish)}` });
  await goLive(robot, { mode: "observe" });
  sockets[0].close(4505);
  mock.timers.tick(500);
  await settle();
  assert.deepEqual(ticketsGiven, Array(2).fill({ robot: "sim 1", mode: "observe" }));
  assert.match(sockets[1].url, /ticket=t2$/);
  assert.deepEqual(asked, []);
});

test("a site that the server refuses is named, where a browser shows no answer at all", async () => {
  globalThis.fetch = async (url, { method }) => {
    if (method === "HEAD" && url.endsWith("/static/dist/robotether-client.js")) return { ok: true };
    throw new TypeError("Failed to fetch");
  };
  const [robot, reasons] = [make(), []];
  robot.on("state", ({ reason }) => reasons.push(reason));
  robot.connect().catch(() => {}); // ends with the test
  await settle();
  assert.match(reasons.at(-1), /is https:\/\/lab\.example in its ALLOWED_ORIGINS\?/);
});

test("when somebody else drives, it connects to watch, and says so", async () => {
  const robot = make();
  const states = [];
  robot.on("state", ({ name, lost, driving }) => states.push([name, lost, driving]));
  const connected = robot.connect();
  await settle();
  sockets[0].open();
  sockets[0].close(4009, "ann drives sim1");
  mock.timers.tick(1);
  await settle();
  assert.equal(asked.at(-1).body.mode, "observe");
  sockets[1].open();
  await settle();
  await connected;
  assert.equal(robot.driving, false);
  assert.deepEqual(states.at(1), ["connecting", "lease_held", false]);
});

test("what can never work rejects, and no answer of a backend is tried again", async () => {
  answers["/api/v1/tickets"] = [404, { code: "robot_unknown" }];
  await assert.rejects(make().connect(), /cannot connect to sim 1/);
  const robot = make({ token: null, getTicket: async () => ticketsGiven.push(1) && Promise.reject(new TypeError("no network")) });
  robot.connect().catch(() => {}); // ends with the test
  await settle();
  mock.timers.tick(500);
  await settle();
  assert.equal(ticketsGiven.length, 2);
});

test("a stop is said on the connection and to the API at once", async () => {
  answers["/api/v1/robots/sim%201/stop"] = [200, {}];
  const robot = await goLive();
  robot.drive({ forward: 0.3 });
  assert.equal(await robot.stop(), true);
  assert.equal(sockets[0].said("robotether.stop").length, 1);
  assert.match(asked.at(-1).url, /\/stop\?press=/);
  assert.equal(sockets[0].said("publish").at(-1).msg.twist.linear.x, 0);
});

test("with tickets alone a stop goes over the connection, and a release needs more", async () => {
  const robot = await goLive(make({ token: null, getTicket: async () => "t" }));
  assert.equal(await robot.stop(), true);
  await assert.rejects(robot.release(), /needs a token or a login/);
  assert.deepEqual(asked, []);
});

test("a stop that nobody has heard of is not reported as one that was", async () => {
  stopped = null;
  for (const options of [{}, { token: null, getTicket: async () => "t" }]) {
    const robot = await goLive(make(options));
    const told = robot.stop();
    await settle();
    mock.timers.tick(3000);
    assert.equal(await told, false);
  }
});

test("the end of the drive by a stop tells that the server has it", async () => {
  stopped = null;
  const robot = await goLive(make({ token: null, getTicket: async () => "t" }));
  const told = robot.stop();
  sockets[0].close(4003, "stopped by ann");
  assert.equal(await told, true);
});

test("what moves gets its zero when the page closes the connection", async () => {
  const robot = await goLive();
  robot.drive({ forward: 0.3 });
  robot.close();
  assert.equal(sockets[0].said("publish").at(-1).msg.twist.linear.x, 0);
  const { length } = sockets[0].sent;
  assert.equal(robot.drive({ forward: 0.3 }), false);
  mock.timers.tick(1000);
  assert.equal(sockets[0].sent.length, length);
});

test("an attempt to connect ends with close(), which is the last state", async () => {
  const robot = make();
  const states = [];
  robot.on("state", ({ name, driving }) => states.push([name, driving]));
  const connected = robot.connect();
  await settle();
  robot.close();
  await assert.rejects(connected, /cannot connect to sim 1: closed/);
  assert.deepEqual(states.at(-1), ["closed", false]);
});

test("a page keeps nothing of a robot that it has closed", async () => {
  const names = ["blur", "offline", "online", "pagehide"];
  // Not what is still in there: once it has collected garbage, Node.js 20 removes one listener of a signal alone.
  const added = mock.method(windowHears, "addEventListener").mock;
  const heard = () => added.calls.map(({ arguments: [name, , { signal }] }) => !signal.aborted && name).filter(Boolean);
  const robot = make();
  for (let i = 0; i < 2; i++) {
    await goLive(robot);
    assert.deepEqual(heard().sort(), names);
    robot.close();
    assert.deepEqual(heard(), []);
  }
});

test("a wheelbase that would steer wrong is refused", () => {
  for (const wheelbase of [0, -0.3, NaN, "0.3"]) assert.throws(() => make({ wheelbase }), /wheelbase is/);
});

test("a release names the stop that was reported to this page", async () => {
  answers["/api/v1/robots/sim%201/release"] = [409, { code: "not_possible", detail: "ben stopped it again" }];
  const robot = await goLive(make(), { mode: "observe" });
  await assert.rejects(robot.release(), /cannot release sim 1: no stop was reported to this page/);
  sockets[0].relaySays({ op: "robotether.control", control: { stopped } });
  await assert.rejects(robot.release(), { message: "ben stopped it again", code: "not_possible" });
  assert.deepEqual(asked.at(-1).body, { by: "ann", at: "2026-01-01T12:03:00Z" });
});

test("a robot that speaks in the relay's name is not believed", async () => {
  const robot = make();
  const controls = [];
  robot.on("control", (control) => controls.push(control));
  await goLive(robot);
  const stamp = () => robot.session.clockSync.stamp(1000);
  const known = stamp();
  const forged = { driver: null, stopped: { by: "nobody", at: "2026-01-01T12:03:00Z", confirmed: true } };
  for (const key of [undefined, null, "", "00112233445566778899aabbccddeeff"]) {
    sockets[0].tell({ op: "robotether.clock_sync", t_ms: 0, relay_ms: 1e9, key });
    sockets[0].tell({ op: "robotether.control", control: forged, key });
  }
  assert.deepEqual(stamp(), known, "commands would look younger than they are");
  assert.deepEqual(controls, []);
  sockets[0].relaySays({ op: "robotether.control", control: forged });
  assert.deepEqual(controls, [forged]);
});

test("a call gives the values, and rejects when it failed", async () => {
  const robot = await goLive();
  assert.deepEqual(await robot.call("/dock", { fast: true }), { got: { fast: true } });
  await assert.rejects(robot.call("/broken"), /cannot call \/broken/);
});

test("a name without its first slash is the same topic", async () => {
  const robot = make({ driveTopic: "cmd_vel" });
  const heard = [];
  robot.subscribe("odom", (message) => heard.push(message));
  await goLive(robot);
  sockets[0].tell({ op: "publish", topic: "/odom", msg: { x: 1 } });
  assert.deepEqual(heard, [{ x: 1 }]);
  robot.publish("lights", "std_msgs/Bool", { data: true });
  robot.publish("/lights", "std_msgs/Bool", { data: false });
  const topics = sockets[0].said("advertise").map(({ topic }) => topic);
  assert.deepEqual(topics, ["/cmd_vel", "/lights"]);
  assert.throws(() => robot.publish("/cmd_vel", "geometry_msgs/Twist", {}), /drive\(\) does/);
});

test("a link on which nothing was asked for stays, as the robot answers each second", async () => {
  let clock = 0;
  mock.method(performance, "now", () => clock);
  const robot = await goLive();
  const after = async (seconds) => {
    for (let i = 0; i < seconds; i++) {
      clock += 1000;
      mock.timers.tick(1000);
      await settle();
    }
    return [robot.driving, robot.roundTripMs, sockets.length];
  };
  assert.deepEqual(await after(20), [true, 0, 1]);
  sockets[0].answer = () => {};
  assert.deepEqual(await after(4), [true, null, 1]);
  assert.equal((await after(4))[0], false);
  robot.close();
  mock.restoreAll();
});

test("it has the age of what its driver sees, as the server reports it", async () => {
  let clock = 0;
  mock.method(performance, "now", () => clock);
  const robot = await goLive();
  const report = () => sockets[0].relaySays({ op: "robotether.seen", age_ms: 140.2 });
  assert.equal(robot.seenAgeMs, null);
  report();
  assert.equal(robot.seenAgeMs, 140.2);
  clock += 2500;
  assert.equal(robot.seenAgeMs, null, "nobody has measured it since");
  report();
  sockets[0].close(1006);
  assert.equal(robot.seenAgeMs, null);
  mock.restoreAll();
});

test("a topic and a service answer over HTTP without a connection", async () => {
  const robot = make();
  const first = { topic: "/arm/state", received_age_s: 0.02, sequence: "a-1", message: { data: 1 } };
  answers["/api/v1/robots/sim%201/topics/arm%2Fstate"] = [200, first];
  assert.deepEqual(await robot.newest("arm/state", { waitS: 30, throttleMs: 100 }), first);
  answers["/api/v1/robots/sim%201/topics/arm%2Fstate"] = [204];
  assert.equal(await robot.newest("arm/state", { since: "a-1" }), null);
  answers["/api/v1/robots/sim%201/services/arm%2Fmove"] = [200, { result: true, values: { ok: true } }];
  assert.deepEqual(await robot.callOnce("arm/move", { x: 1 }, { timeoutS: 9 }), { ok: true });
  const queries = asked.map(({ url }) => new URL(url).search);
  assert.deepEqual(queries, ["?throttle_rate=100&wait_s=30", "?since=a-1", "?timeout_s=9"]);
  assert.deepEqual(asked[2].body, { x: 1 });
  answers["/api/v1/robots/sim%201/services/arm%2Fmove"] = [200, { result: false, reason: "it is broken" }];
  await assert.rejects(robot.callOnce("arm/move"), /cannot call arm\/move: it is broken/);
  answers["/api/v1/robots/sim%201/services/arm%2Fmove"] = [409, { code: "lease_held", detail: "ben drives" }];
  await assert.rejects(robot.callOnce("arm/move"), { message: "ben drives", code: "lease_held" });
});

test("a page that names the MAC of its robot asks nothing of another one that has got the name", async () => {
  const mac = "02:00:00:00:00:07";
  const robot = await goLive(make({ mac }));
  assert.deepEqual(asked[0].body, { robot: "sim 1", mode: "drive", mac });
  sockets[0].relaySays({ op: "robotether.control", control: { stopped } });
  await robot.stop();
  const refused = [robot.release(), robot.lease("ask"), robot.newest("odom"), robot.callOnce("arm/move")];
  await Promise.allSettled(refused);
  assert.deepEqual(new Set(asked.slice(1).map(({ url }) => new URL(url).searchParams.get("mac"))), new Set([mac]));
  assert.match(await robot.streamUrl(), /&mac=02%3A00%3A00%3A00%3A00%3A07/);
  const getTicket = async (wish) => ticketsGiven.push(wish) && "t1";
  await goLive(make({ mac, getTicket }));
  assert.deepEqual(ticketsGiven, [{ robot: "sim 1", mode: "drive", mac }]);
});

test("commands name the frames of the cameras that are shown, else of the last ones, none before the first and nothing without video", async () => {
  class Image {
    localName = "img";
    set src(_) {
      this.onload();
    }
  }
  Object.assign(globalThis, { WebSocket: FakeWebSocket, requestAnimationFrame: (act) => act() });
  const robot = make({ token: null, getTicket: async () => "t1" });
  const seen = () => robot.session.stamp(performance.now())?.seen;
  assert.equal(seen(), undefined);
  const streams = [];
  const [front, rear] = [41, 7].map((frame) => ({ camera: `/${frame}`, frame }));
  for (const { camera: topic, frame: sequence } of [front, rear]) {
    streams.push(robot.showVideo(new Image(), { topic }));
    if (topic === front.camera) assert.deepEqual(seen(), []);
    await settle();
    sockets.at(-1).open();
    sockets.at(-1).answerClockSync(0);
    sockets.at(-1).frame({ sequence, timestampMs: performance.now(), data: [...JPEG] });
    await settle();
  }
  assert.deepEqual(seen(), [front, rear]);
  streams[0].stop();
  assert.deepEqual(seen(), [rear]);
  streams[1].stop();
  assert.deepEqual(seen(), [rear]);
  assert.throws(() => robot.showVideo({ localName: "p" }), /cannot show video in <p>/);
});
