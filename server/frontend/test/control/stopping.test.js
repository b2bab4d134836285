import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Stopping, sameStop } from "../../src/control/stopping.js";
import { stop as texts } from "../../src/texts/common.js";

const OK = { ok: true, status: 200, detail: "" };
const NO_ANSWER = { ok: false, status: 0, detail: "" };
const BY_BEN = { by: "ben", at: "2026-01-01T12:03:00Z" };

let ways, answers, stopping;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  ways = [];
  answers = [];
  stopping = new Stopping({
    send: () => ways.push("link"),
    post: () => {
      ways.push("post");
      return new Promise((resolve) => answers.push(resolve));
    },
    onChange: () => {},
  });
});

async function answer(what) {
  answers.at(-1)(what);
  for (let i = 0; i < 5; i++) await Promise.resolve();
}

const kind = () => stopping.shown.kind;

test("a press goes out on both ways before either has answered", () => {
  stopping.press();
  assert.deepEqual(ways, ["link", "post"]);
  assert.equal(kind(), "asked");
});

test("only what is confirmed is said: server, then robot", async () => {
  stopping.press();
  await answer(OK);
  assert.deepEqual([kind(), stopping.holds], ["heard", true]);
  stopping.receive({ ...BY_BEN, confirmed: false });
  assert.equal(kind(), "stopping");
  stopping.receive({ ...BY_BEN, confirmed: true });
  assert.deepEqual([stopping.shown, stopping.holds], [{ kind: "stopped", by: "ben", at: BY_BEN.at }, true]);
  stopping.receive(null);
  assert.equal(kind(), "none");
});

test("the attempts end after a while, ask for another press and then keep nobody from going on", async () => {
  assert.equal(stopping.holds, false);
  stopping.press();
  for (let i = 0; i < 15; i++) {
    assert.equal(stopping.holds, true);
    await answer(NO_ANSWER);
    mock.timers.tick(1000);
  }
  assert.deepEqual([kind(), stopping.holds], ["failed", false]);
  const before = ways.length;
  mock.timers.tick(60_000);
  assert.equal(ways.length, before);
});

test("the attempts end when the stop was heard of on another way", async () => {
  stopping.press();
  await answer(NO_ANSWER);
  stopping.receive({ ...BY_BEN, confirmed: true });
  mock.timers.tick(60_000);
  assert.deepEqual(ways, ["link", "post"]);
  assert.equal(kind(), "stopped");
});

test("a late answer to a stop that was released meanwhile says nothing", async () => {
  stopping.press();
  stopping.receive({ ...BY_BEN, confirmed: true });
  stopping.receive(null);
  await answer(NO_ANSWER);
  assert.equal(kind(), "none");
});

test("a refusal is final and gives its reason", async () => {
  stopping.press();
  await answer({ ok: false, status: 404, detail: "there is no such robot" });
  assert.deepEqual([kind(), stopping.holds], ["refused", false]);
  mock.timers.tick(60_000);
  assert.deepEqual(ways, ["link", "post"]);
  assert.match(texts.refused(stopping.shown), /no such robot/);
});

test("news of a robot that is not stopped does not hide a stop that is on its way", async () => {
  stopping.press();
  stopping.receive(null);
  assert.equal(kind(), "asked");
  await answer(OK);
  stopping.receive(null);
  assert.equal(kind(), "heard");
  mock.timers.tick(5000);
  assert.equal(kind(), "none");
});

test("a stop that the server has is not forgotten while the page hears nothing", async () => {
  stopping.press();
  await answer(OK);
  mock.timers.tick(60_000);
  assert.equal(kind(), "heard");
  stopping.receive(null);
  mock.timers.tick(5000);
  assert.equal(kind(), "none");
});

test("the release of an earlier stop does not end a stop that is on its way", async () => {
  stopping.receive({ ...BY_BEN, confirmed: true });
  stopping.press();
  stopping.receive(null);
  assert.equal(kind(), "asked");
  await answer(NO_ANSWER);
  assert.equal(kind(), "unheard");
  mock.timers.tick(1000);
  assert.deepEqual(ways, ["link", "post", "link", "post"]);
  await answer(OK);
  assert.equal(kind(), "heard");
});

test("news of somebody else's earlier stop does not end a stop that is on its way", async () => {
  stopping.receive({ ...BY_BEN, confirmed: false });
  stopping.press();
  stopping.receive({ ...BY_BEN, confirmed: true });
  await answer(NO_ANSWER);
  mock.timers.tick(1000);
  assert.deepEqual(ways, ["link", "post", "link", "post"]);
  stopping.receive({ by: "me", at: BY_BEN.at, confirmed: true });
  await answer(NO_ANSWER);
  mock.timers.tick(60_000);
  assert.equal(ways.length, 4);
  assert.equal(stopping.shown.by, "me");
});

test("a stop is another one by its name or moment, not by its confirmation", () => {
  assert.ok(sameStop({ ...BY_BEN, confirmed: false }, { ...BY_BEN, confirmed: true }));
  assert.ok(sameStop(null, undefined));
  assert.ok(!sameStop(BY_BEN, null));
  assert.ok(!sameStop(BY_BEN, { ...BY_BEN, by: "ann" }));
  assert.ok(!sameStop(BY_BEN, { ...BY_BEN, at: "2026-01-01T12:03:01Z" }));
});

test("a second press is said again at once", () => {
  stopping.press();
  stopping.press();
  assert.deepEqual(ways, ["link", "post", "link", "post"]);
});

test("every kind has its sentence, and only a confirmed stop is called one", () => {
  const facts = { by: "ben", at: "12:03", detail: "" };
  for (const name of ["asked", "heard", "unheard", "failed", "refused", "stopping", "stopped"]) {
    assert.ok(texts[name](facts), name);
    assert.equal(texts[name](facts).startsWith("Stopped"), name === "stopped");
  }
});
