import assert from "node:assert/strict";
import { beforeEach, describe, test } from "node:test";

import { byTestId, part } from "../../src/dom/page.js";
import { Alerts } from "../../src/queue/alerts.js";
import { AskForHelp } from "../../src/queue/askForHelp.js";
import { Availability } from "../../src/queue/availability.js";
import { Poller, startTicking } from "../../src/queue/poller.js";
import { requestFacts, stateText } from "../../src/queue/requestRows.js";
import { figureTexts, operatorFacts, periodWords } from "../../src/queue/supervision.js";
import { FakeElement, settle, storageOf } from "../fakes.js";

test("an offer sounds at once and every two seconds, and its name and the page's take turns in the title", () => {
  const page = { title: "Queue" };
  const sound = { played: 0, play: () => sound.played++ };
  const alerts = new Alerts({ choices: { all: {} }, page, sound });
  const titles = (count) => Array.from({ length: count }, () => (alerts.tick(), page.title));
  alerts.offer("Offer: sim1");
  assert.deepEqual([page.title, sound.played], ["Offer: sim1", 1]);
  assert.deepEqual(titles(4), ["Queue", "Offer: sim1", "Queue", "Offer: sim1"]);
  assert.equal(sound.played, 3);
  alerts.offer("");
  assert.deepEqual(titles(2), ["Queue", "Queue"]);
  assert.equal(sound.played, 3);
});

globalThis.document = { createElement: () => new FakeElement(), activeElement: null };

test("a request that comes does not move the others, whose buttons may be under a finger", () => {
  const root = new FakeElement();
  const help = new AskForHelp(root, { robot: "sim1", mac: "m1", level: "manage", me: "ann", post: async () => ({}), onAsked() {} });
  const request = (id, priority) => ({ id, mac: "m1", priority, reason: `reason ${id}`, state: "waiting", age_s: 1 });
  help.receive([request(1, 2), request(2, 3)]);
  const ofOther = { ...request(4, 1), mac: "m2" }; // a robot that has got the name
  help.receive([ofOther, request(3, 1), request(2, 1), request(1, 2)]); // the most urgent first
  const reasons = part(part(root, "help"), "help-list").children.map((item) => part(item, "reason").textContent);
  assert.deepEqual(reasons, ["reason 1", "reason 2", "reason 3"]);
});

test("who works on a request closes it on the drive page, and who asked withdraws it", async () => {
  const [root, posted] = [new FakeElement(), []];
  const help = new AskForHelp(root, {
    robot: "sim1",
    mac: "m1",
    level: "drive",
    me: "ann",
    post: async (path) => posted.push(path) && { ok: true },
    onAsked() {},
  });
  const request = (id, more) => ({ id, mac: "m1", source: "page", asked_by: "ben", state: "accepted", age_s: 1, ...more });
  const asked = request(7, { state: "waiting", asked_by: "ann" });
  help.receive([request(6, { accepted_by: "ann" }), asked, request(8, { accepted_by: "ben" })]);
  const items = part(part(root, "help"), "help-list").children;
  for (const item of items.slice(0, 2)) item.children[1].dispatchEvent(new Event("click"));
  await settle();
  assert.deepEqual(posted, ["/api/v1/requests/6/close", "/api/v1/requests/7/cancel"]);
  const ends = items.map((item) => byTestId(item, "help-withdraw"));
  assert.deepEqual(
    ends.map(({ hidden, textContent }) => (hidden ? "" : textContent)),
    ["Close", "Withdraw", ""],
  );
});

test("what is not known of a request or of an operator is said to be", () => {
  const unknown = { robot: "sim1", reason: "", source: "battery", priority: 9, pool: "", asked_by: null, age_s: null, state: "new" };
  const { reason, priority, pool, asker, age, state } = requestFacts(unknown);
  assert.deepEqual([reason, priority, pool, asker, age, state], ["Battery low", "-", "Any", "-", "-", "-"]);
  assert.equal(stateText("", null), "It is not known whether you are available.");
});

test("figures and operators that are not known are -", () => {
  assert.equal(periodWords({ name: "made", values: [null] }, "count"), "Asked: - in all, at most -");
  const figures = { open: 0, oldest_open_s: null, waiting_p50_s: 10.6, waiting_p95_s: 63, answered: 12 };
  assert.deepEqual(figureTexts(figures), { open: "0", oldest: "-", p50: "11 s", p95: "1 min 3 s", answered: "12" });
  const away = { user: "ben", state: "away", since: null, request: null, pools: [] };
  assert.deepEqual(operatorFacts(away), { user: "ben", "operator-state": "Away", since: "-", request: "-", pools: "-" });
});

describe("availability", () => {
  const START = Date.parse("2026-01-01T12:00:00Z");

  let now, availability;

  beforeEach(() => {
    now = START;
    availability = new Availability({ now: () => now });
  });

  // A heartbeat and its answer.
  function heartbeat(view) {
    const sent = availability.body;
    availability.receive(view, sent);
    return sent;
  }

  const AVAILABLE = { state: "available", available: true };
  const AWAY = { state: "away", available: false };

  test("a choice is sent until the server has it, and other heartbeats change nothing", () => {
    assert.deepEqual(heartbeat(AWAY), {}, "nobody is available who did not choose it");
    availability.choose("available");
    assert.deepEqual(availability.body, { state: "available" });
    assert.deepEqual(heartbeat(AVAILABLE), { state: "available" });
    assert.deepEqual(heartbeat(AVAILABLE), {});
    availability.choose("away");
    now += 10_001;
    assert.deepEqual(availability.body, {}, "a press that did not reach the server in 10 s");
  });

  test("a page that slept says from when to when, and another window is told apart; Available ends both", () => {
    heartbeat(AVAILABLE);
    now += 63_000;
    heartbeat(AWAY);
    assert.deepEqual(availability.lapse, { why: "silent", from: new Date(START), to: new Date(START + 63_000) });
    availability.choose("available");
    assert.equal(availability.lapse, null);
    heartbeat(AVAILABLE);
    now += 1000;
    heartbeat(AWAY);
    assert.equal(availability.lapse.why, "other");
    availability.choose("available");
    heartbeat({ ...AVAILABLE, offer: {} });
    heartbeat(AWAY);
    assert.equal(availability.lapse.why, "unanswered");
  });

  // The page asks all the time, and nobody answers.
  function outage(seconds) {
    for (let second = 0; second < seconds; second += 5) {
      now += 5000;
      assert.ok(availability.body);
    }
  }

  test("after an outage of the server the choice holds again, unless it was to be away", () => {
    heartbeat(AVAILABLE);
    outage(60);
    heartbeat(AWAY);
    assert.equal(availability.lapse, null);
    assert.deepEqual(heartbeat(AVAILABLE), { state: "available" });
    outage(30);
    availability.choose("away");
    outage(30);
    heartbeat(AWAY);
    assert.deepEqual(availability.body, {});
  });

  test("who chose to be away is told nothing, and is busy without being available", () => {
    heartbeat({ state: "busy", available: true });
    availability.choose("away");
    heartbeat({ state: "busy", available: false });
    assert.deepEqual([availability.lapse, availability.isAvailable], [null, false]);
  });
});

describe("questions to the server", () => {
  const START = Date.parse("2026-01-01T12:00:00Z");
  const NO_ANSWER = { status: 0, ok: false, detail: "" };

  let now, asked, states, bodies, poller;

  beforeEach(() => {
    [now, asked, states, bodies] = [START, [], [], []];
    poller = new Poller({
      ask: () => new Promise((resolve) => asked.push(resolve)),
      onAnswer: (body) => bodies.push(body),
      onState: (state) => states.push(state),
      now: () => now,
    });
  });

  function tick(ms = 1000) {
    now += ms;
    poller.tick();
  }

  async function answer(result) {
    asked.at(-1)(result);
    await new Promise(setImmediate);
  }

  const ok = (body) => answer({ ok: true, status: 200, detail: "", body });

  test("it asks once a second, and never twice at once", async () => {
    tick();
    tick(100);
    assert.equal(asked.length, 1);
    await ok("first");
    tick(300);
    assert.equal(asked.length, 1, "too soon");
    tick(600);
    assert.equal(asked.length, 2);
    assert.deepEqual([bodies, poller.isLive], [["first"], true]);
    await ok("second");
    tick(-3_600_000);
    assert.equal(asked.length, 3, "the clock was set back");
  });

  test("without an answer for 4 s, or with a refusal, what is shown is old since the last answer", async () => {
    tick();
    await ok("first");
    tick();
    tick(3000);
    assert.equal(poller.isLive, true);
    tick();
    assert.deepEqual(states.at(-1), { name: "lost", since: new Date(START + 1000), detail: "" });
    assert.equal(asked.length, 3, "it asks anew");
    await answer({ ...NO_ANSWER, status: 503, detail: "the database is away" });
    assert.equal(states.length, 2, "said once");
    tick();
    await ok("second");
    assert.equal(states.at(-1).name, "live");
  });

  test("an answer that a newer question has overtaken counts no more", async () => {
    tick();
    const late = asked[0];
    poller.askNow();
    await ok("after the press");
    late({ ok: true, status: 200, detail: "", body: "before the press" });
    await new Promise(setImmediate);
    assert.deepEqual(bodies, ["after the press"]);
  });

  test("an ended login ends the questions", async () => {
    tick();
    await answer({ ...NO_ANSWER, status: 401 });
    tick();
    assert.deepEqual([asked.length, states.at(-1).name], [1, "login"]);
  });

  test("a worker keeps time, and the page itself does where there can be none", (t) => {
    t.mock.timers.enable({ apis: ["setInterval"] });
    let ticks = 0;
    const worker = new EventTarget();
    startTicking(() => ticks++, "/ticker.js", { makeWorker: () => worker });
    worker.dispatchEvent(new Event("message"));
    t.mock.timers.tick(3000);
    assert.equal(ticks, 1);
    worker.dispatchEvent(new Event("error"));
    t.mock.timers.tick(3000);
    assert.equal(ticks, 4);
    const makeWorker = () => {
      throw new Error("not here");
    };
    startTicking(() => ticks++, "/ticker.js", { makeWorker });
    t.mock.timers.tick(1000);
    assert.equal(ticks, 6);
  });
});

test("another request gets neither the note nor a press that was meant for the one before", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout", "setInterval", "Date"] });
  const page = new FakeElement();
  const main = page.querySelector("main");
  const of = { document: globalThis.document, window: globalThis.window };
  Object.assign(globalThis, { document: Object.assign(page, { ...of.document, body: page, hidden: false }), window: new EventTarget() });
  let id = 7;
  const closed = [];
  const kept = new Map([["robotether.queue.note", JSON.stringify({ id: "7", note: "lost on" })]]);
  Object.defineProperty(globalThis, "sessionStorage", { value: storageOf(kept), configurable: true });
  context.mock.method(globalThis, "fetch", async (path) => {
    if (path.endsWith("/close")) closed.push(path);
    return Response.json({ state: "busy", current: { id, robot: "sim1" }, waiting: [] });
  });
  const buttons = part(main, "current").querySelectorAll();
  part(main, "current").querySelectorAll = () => buttons;
  buttons.push(byTestId(main, "close-request"));
  const close = () => part(main, "close").dispatchEvent(new Event("submit"));
  const next = async (ms) => (context.mock.timers.tick(ms), settle());
  await import("../../src/pages/queue.js");
  await next(1500);
  assert.equal(byTestId(main, "close-note").value, "lost on", "as it was written before the page was opened again");
  Object.assign(byTestId(main, "close-note"), { value: "lost on the ramp" }).dispatchEvent(new Event("input"));
  assert.match(kept.get("robotether.queue.note") ?? "", /lost on the ramp/);
  await next(1000);
  assert.equal(byTestId(main, "close-note").value, "lost on the ramp");
  id = 8;
  await next(1000);
  assert.equal(byTestId(main, "close-note").value, "");
  close();
  assert.deepEqual(closed, []);
  await next(1500);
  close();
  assert.deepEqual(closed, ["/api/v1/requests/8/close"]);
  Object.assign(globalThis, of);
});
