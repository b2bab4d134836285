import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Stopping, sameStop } from "../../src/control/stopping.js";
import { stop as texts } from "../../src/texts/common.js";

const OK = { ok: true, status: 200, detail: "" };
const NO_ANSWER = { ok: false, status: 0, detail: "" };
const BUSY = { ok: false, status: 429, detail: "" };
const DOWN = { ok: false, status: 503, detail: "" };
const BY_BEN = { by: "ben", at: "2026-01-01T12:03:00Z" };

let ways, answers, presses, stopping;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  ways = [];
  answers = [];
  presses = [];
  stopping = new Stopping({
    send: (id) => presses.push(id) && ways.push("link"),
    post: (id) => {
      presses.push(id);
      ways.push("post");
      return new Promise((resolve) => answers.push(resolve));
    },
    onChange: () => {},
  });
});

async function answer(what, nth = -1) {
  answers.at(nth)(what);
  for (let i = 0; i < 5; i++) await Promise.resolve();
}

const press = () => stopping.press();
const receive = (stopped) => stopping.receive(stopped);
const stoppedBy = (by, confirmed = true) => receive({ by, at: BY_BEN.at, confirmed });
const tick = (ms) => mock.timers.tick(ms);
const kind = () => stopping.shown.kind;

test("only what is confirmed is said: server, then robot", async () => {
  press();
  await answer(OK);
  assert.deepEqual([kind(), stopping.holds], ["heard", true]);
  stoppedBy("ben", false);
  assert.equal(kind(), "stopping");
  stoppedBy("ben");
  assert.deepEqual([stopping.shown, stopping.holds], [{ kind: "stopped", by: "ben", at: BY_BEN.at }, true]);
  receive(null);
  assert.equal(kind(), "none");
});

test("both ways of an attempt say the same press, and the next attempt another", async () => {
  press();
  await answer(NO_ANSWER);
  tick(1000);
  const [link, post, next] = presses;
  assert.deepEqual([link === post, link === next, presses.length], [true, false, 4]);
});

test("the attempts end after a while, ask for another press and then keep nobody from going on", async () => {
  assert.equal(stopping.holds, false);
  press();
  for (let i = 0; i < 15; i++) {
    assert.equal(stopping.holds, true);
    await answer(NO_ANSWER);
    tick(1000);
  }
  assert.deepEqual([kind(), stopping.holds, ways.length], ["failed", false, 30]);
  tick(60_000);
  assert.equal(ways.length, 30);
});

test("a refusal is final and gives its reason", async () => {
  press();
  await answer({ ok: false, status: 404, detail: "there is no such robot" });
  assert.deepEqual([kind(), stopping.holds], ["refused", false]);
  tick(60_000);
  assert.deepEqual(ways, ["link", "post"]);
  assert.match(texts.refused(stopping.shown), /no such robot/);
});

// What is said after some steps, each with the answer that comes then, and how often the stop was sent on both ways.
for (const [name, steps, said, times] of [
  ["a press goes out on both ways before either has answered", [press], "asked", 1],
  ["a second press is said again at once", [press, press], "asked", 2],
  ["a late answer to the press before says nothing", [press, press, () => answer(OK, 0)], "asked", 2],
  ["without an answer it is said again", [press, NO_ANSWER, () => tick(1000), OK], "heard", 2],
  ["what was heard of on another way ends the attempts", [press, NO_ANSWER, () => stoppedBy("ben"), () => tick(60_000)], "stopped", 1],
  ["a late answer to a stop that was released says nothing", [press, () => stoppedBy("ben"), () => receive(null), NO_ANSWER], "none", 1],
  ["no news of a stop hides none that is on its way", [press, () => receive(null)], "asked", 1],
  ["nor one that the server has, for a while", [press, () => receive(null), OK, () => receive(null)], "heard", 1],
  ["nor longer", [press, () => receive(null), OK, () => receive(null), () => tick(5000)], "none", 1],
  [
    "one that the server has is not forgotten while the page hears nothing",
    [() => receive(null), press, OK, () => tick(60_000)],
    "heard",
    1,
  ],
  ["until it hears something", [press, OK, () => tick(60_000), () => receive(null), () => tick(5000)], "none", 1],
  ["the release of an earlier stop ends none on its way", [() => stoppedBy("ben"), press, () => receive(null), NO_ANSWER], "unheard", 1],
  ["nor one that was not heard yet", [() => stoppedBy("ben"), press, NO_ANSWER, () => receive(null), () => tick(1000)], "unheard", 2],
  ["a server that is busy or down is told again", [press, BUSY, () => tick(1000), DOWN, () => tick(1000)], "unheard", 3],
]) {
  test(name, async () => {
    for (const step of steps) await (typeof step === "function" ? step() : answer(step));
    assert.deepEqual([kind(), ways], [said, Array(times).fill(["link", "post"]).flat()]);
  });
}

test("news of somebody else's earlier stop does not end a stop that is on its way", async () => {
  stoppedBy("ben", false);
  press();
  stoppedBy("ben");
  await answer(NO_ANSWER);
  tick(1000);
  assert.deepEqual(ways, ["link", "post", "link", "post"]);
  stoppedBy("me");
  await answer(NO_ANSWER);
  tick(60_000);
  assert.deepEqual([ways.length, stopping.shown.by], [4, "me"]);
});

test("a stop is another one by its name or timestamp, not by its confirmation", () => {
  assert.ok(sameStop({ ...BY_BEN, confirmed: false }, { ...BY_BEN, confirmed: true }));
  assert.ok(sameStop(null, undefined));
  assert.ok(!sameStop(BY_BEN, null));
  assert.ok(!sameStop(BY_BEN, { ...BY_BEN, by: "ann" }));
  assert.ok(!sameStop(BY_BEN, { ...BY_BEN, at: "2026-01-01T12:03:01Z" }));
});

test("every kind has its sentence, and only a confirmed stop is called one", () => {
  const facts = { by: "ben", at: "12:03", detail: "" };
  for (const name of ["asked", "heard", "unheard", "failed", "refused", "stopping", "stopped"]) {
    assert.ok(texts[name](facts), name);
    assert.equal(texts[name](facts).startsWith("Stopped"), name === "stopped");
  }
});
