import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Poller, startTicking } from "../../src/queue/poller.js";

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
