import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { RobotButtons, answerWords, refusalWords, succeeded } from "../../src/control/robotButtons.js";

const LIGHTS = { name: "Lights on", kind: "publish", topic: "/lights", type: "std_msgs/Bool", msg: { data: true }, confirm: false };
const DOCK = { name: "Dock", kind: "call", service: "/dock", type: "std_srvs/Trigger", args: {}, confirm: true };
const SCAN = { name: "Scan", kind: "call", service: "/scan", type: "", args: { n: 1 }, confirm: false };

let publishers, calls, reported, robotButtons, lights, dock, scan;

beforeEach(() => {
  mock.timers.enable({ apis: ["setTimeout"] });
  publishers = [];
  calls = [];
  reported = [];
  robotButtons = new RobotButtons({
    buttons: [LIGHTS, DOCK, SCAN],
    connection: {
      advertise: (spec) => {
        const made = { ...spec, published: [], ended: false };
        publishers.push(made);
        return { publish: (msg) => made.published.push(msg) > 0, end: () => (made.ended = true) };
      },
      call: (...how) => new Promise((resolve, reject) => calls.push({ how, resolve, reject })),
    },
    onChange: ({ button, state }) => reported.push([button.name, state]),
  });
  [lights, dock, scan] = robotButtons.all;
});

afterEach(() => mock.timers.reset());

const drive = () => robotButtons.use({ live: true, driving: true });
const settle = () => new Promise((resolve) => setImmediate(resolve));

test("nothing is sent unless the page drives", () => {
  robotButtons.use({ live: true, driving: false });
  for (const action of robotButtons.all) robotButtons.press(action);
  robotButtons.confirm(dock);
  assert.deepEqual([publishers, calls], [[], []]);
});

test("a publisher stands from when the page drives until it does no more", () => {
  drive();
  assert.deepEqual(
    publishers.map(({ name, type }) => [name, type]),
    [["/lights", "std_msgs/Bool"]],
  );
  robotButtons.press(lights);
  robotButtons.press(lights);
  assert.deepEqual(publishers[0].published, [{ data: true }, { data: true }]);
  assert.equal(lights.state, "sent");
  robotButtons.use({ live: false, driving: true });
  assert.equal(publishers[0].ended, true);
});

test("what the server refuses to publish is said", () => {
  drive();
  robotButtons.press(lights);
  publishers[0].onRefused("cannot publish to /lights: the robot's policy does not let you");
  assert.equal(lights.state, "failed");
  assert.match(lights.words, /Lights on: failed\. cannot publish to \/lights: the robot's policy/);
});

test("a button that asks does nothing until it is answered, and forgets its question", () => {
  drive();
  robotButtons.press(dock);
  assert.equal(dock.state, "asking");
  robotButtons.press(dock);
  assert.equal(calls.length, 0);
  mock.timers.tick(500);
  robotButtons.cancel(dock);
  robotButtons.confirm(dock);
  assert.equal(calls.length, 0);
  robotButtons.press(dock);
  mock.timers.tick(10_000);
  assert.equal(dock.state, "idle");
  robotButtons.press(dock);
  mock.timers.tick(500);
  robotButtons.confirm(dock);
  assert.deepEqual(calls[0].how, ["/dock", {}, "std_srvs/Trigger"]);
});

test("the second press of a double one does not answer what the first one asked", () => {
  drive();
  robotButtons.press(dock);
  mock.timers.tick(499);
  robotButtons.confirm(dock);
  assert.deepEqual([dock.state, dock.open, calls.length], ["asking", false, 0]);
  mock.timers.tick(1);
  assert.equal(dock.open, true);
  robotButtons.cancel(dock);
  robotButtons.press(dock);
  robotButtons.confirm(dock);
  assert.equal(calls.length, 0);
});

test("a question does not outlast the driving", () => {
  drive();
  robotButtons.press(dock);
  mock.timers.tick(500);
  robotButtons.use({ live: true, driving: false });
  assert.equal(dock.state, "idle");
  drive();
  robotButtons.confirm(dock);
  assert.equal(calls.length, 0);
});

test("the robot's own words are shown, whether it did it or not", async () => {
  drive();
  robotButtons.press(scan);
  assert.equal(scan.state, "pending");
  assert.deepEqual(calls[0].how, ["/scan", { n: 1 }, undefined]);
  calls[0].resolve({ ok: true, values: { success: true, message: "found 3" } });
  await settle();
  assert.deepEqual([scan.state, scan.words], ["done", "Scan: done. The robot says: found 3"]);
  robotButtons.press(scan);
  calls[1].resolve({ ok: true, values: { success: false, message: "no laser" } });
  await settle();
  assert.deepEqual([scan.state, scan.words], ["failed", "Scan: failed. no laser"]);
});

test("a press while an answer is awaited sends nothing more", () => {
  drive();
  robotButtons.press(scan);
  robotButtons.press(scan);
  assert.equal(calls.length, 1);
});

test("a robot that does not answer is said after a while, and its late answer counts", async () => {
  drive();
  robotButtons.press(scan);
  mock.timers.tick(30_000);
  assert.deepEqual([scan.state, scan.words], ["failed", "Scan: failed. No answer for 30 s. The robot may still do it."]);
  calls[0].resolve({ ok: true, values: {} });
  await settle();
  assert.equal(scan.state, "done");
});

test("an answer to an earlier press says nothing of the newer one", async () => {
  drive();
  robotButtons.press(scan);
  mock.timers.tick(30_000);
  robotButtons.press(scan);
  calls[0].resolve({ ok: true, values: {} });
  await settle();
  assert.equal(scan.state, "pending");
});

test("a link that ends leaves open whether it was done", () => {
  drive();
  robotButtons.press(scan);
  robotButtons.use({ live: false, driving: true });
  assert.equal(scan.state, "failed");
  assert.match(scan.words, /may have done it/);
});

test("a call that cannot be sent has failed", async () => {
  drive();
  robotButtons.press(scan);
  calls[0].reject(new Error("cannot call /scan: not connected"));
  await settle();
  assert.deepEqual([scan.state, scan.words], ["failed", "Scan: failed. The robot is not connected."]);
});

test("success is what rosbridge and the service both call so", () => {
  assert.equal(succeeded({ ok: true, values: {} }), true);
  assert.equal(succeeded({ ok: true, values: { success: true } }), true);
  assert.equal(succeeded({ ok: true, values: { success: false } }), false);
  assert.equal(succeeded({ ok: false, values: "no such service" }), false);
});

test("an answer is its message, its other values, or a text", () => {
  assert.equal(answerWords({ values: { success: true, message: "docked" } }), "docked");
  assert.equal(answerWords({ values: { success: true } }), "");
  assert.equal(answerWords({ values: { sum: 3 } }), '{"sum":3}');
  assert.equal(answerWords({ values: {} }), "");
  assert.equal(answerWords({ values: null }), "");
  assert.equal(answerWords({ values: "service /x does not exist" }), "service /x does not exist");
});

test("what a robot says is cut before it fills the page", () => {
  assert.equal(answerWords({ values: { message: "x".repeat(1000) } }).length, 301);
  assert.equal(refusalWords("x".repeat(1000)).length, 301);
  assert.equal(refusalWords(undefined), "");
});
