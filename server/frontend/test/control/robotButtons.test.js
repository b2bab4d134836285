import assert from "node:assert/strict";
import { afterEach, beforeEach, mock, test } from "node:test";

import { RobotButtons, answerWords, refusalWords, succeeded } from "../../src/control/robotButtons.js";
import { settle } from "../fakes.js";

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
const watch = () => robotButtons.use({ live: true, driving: false });
const press = (action) => robotButtons.press(action);
const confirm = () => robotButtons.confirm(dock);
const tick = (ms) => mock.timers.tick(ms);
const answer = (nth, values = {}) => [calls[nth].resolve({ ok: true, values }), settle()].at(-1);

test("nothing is sent unless the page drives", () => {
  watch();
  for (const action of robotButtons.all) press(action);
  confirm();
  assert.deepEqual([publishers, calls], [[], []]);
});

test("a publisher stands from when the page drives until it does no more", () => {
  drive();
  assert.deepEqual([publishers.length, publishers[0].name, publishers[0].type], [1, "/lights", "std_msgs/Bool"]);
  press(lights);
  press(lights);
  assert.deepEqual([publishers[0].published, lights.state], [[{ data: true }, { data: true }], "sent"]);
  robotButtons.use({ live: false, driving: true });
  assert.equal(publishers[0].ended, true);
});

test("a button that asks sends once it is answered", () => {
  drive();
  press(dock);
  tick(500);
  confirm();
  assert.deepEqual(calls[0].how, ["/dock", {}, "std_srvs/Trigger", 31]);
});

// Of the button that asks: what it is after some steps; none of them sends anything.
for (const [name, act, state, open] of [
  ["a button that asks does nothing until it is answered", () => [press(dock), press(dock)], "asking", false],
  ["the second press of a double one is no answer", () => [press(dock), tick(499), confirm()], "asking", false],
  ["then it can be answered", () => [press(dock), tick(500)], "asking", true],
  ["what was cancelled is not answered", () => [press(dock), tick(500), robotButtons.cancel(dock), confirm()], "idle", false],
  ["nor opened by the press before it", () => [press(dock), tick(500), robotButtons.cancel(dock), press(dock), confirm()], "asking", false],
  ["it forgets its question", () => [press(dock), tick(10_000)], "idle", false],
  ["a question does not outlast the driving", () => [press(dock), tick(500), watch(), drive(), confirm()], "idle", false],
]) {
  test(name, () => {
    drive();
    act();
    assert.deepEqual([dock.state, dock.open, calls], [state, open, []]);
  });
}

const refuse = () => [calls[0].reject(new Error("not connected")), settle()].at(-1);
const UNKNOWN = "Scan: outcome unknown.";
const ENDED = "The connection ended before the robot answered. It may have done it, or still do it.";

// What is said of a press, by what becomes of it.
for (const [name, button, act, state, words] of [
  ["it waits for the robot", () => scan, () => {}, "pending", "Scan: waiting for the robot."],
  ["it did it", () => scan, () => answer(0, { success: true, message: "found 3" }), "done", "Scan: done. The robot says: found 3"],
  ["it did not", () => scan, () => answer(0, { success: false, message: "no laser" }), "failed", "Scan: failed. no laser"],
  ["no answer for a while", () => scan, () => tick(30_000), "unknown", `${UNKNOWN} No answer for 30 s. The robot may still do it.`],
  ["a late answer counts", () => scan, () => [tick(30_000), answer(0)].at(-1), "done", "Scan: done."],
  ["but not of a newer press", () => scan, () => [tick(30_000), press(scan), answer(0)].at(-1), "pending", "Scan: waiting for the robot."],
  ["the server refuses it", () => lights, () => publishers[0].onRefused("cannot publish"), "failed", "Lights on: failed. cannot publish"],
  ["a link that ends", () => scan, () => robotButtons.use({ live: false, driving: true }), "unknown", `${UNKNOWN} ${ENDED}`],
  ["a call that cannot be sent", () => scan, () => refuse(), "failed", "Scan: failed. The robot is not connected."],
]) {
  test(`words of a press: ${name}`, async () => {
    drive();
    press(button());
    await act();
    assert.deepEqual([button().state, button().words], [state, words]);
  });
}

const HEARD = "Lights on: sent to the robot.";
const UNHEARD = "Lights on: failed. Nothing on the robot listens to /lights.";
const UNSEEN = "Lights on: outcome unknown. rosapi names no node that listens to /lights.";
for (const [name, publishers, subscribers, words, type = LIGHTS.type] of [
  ["is done where something listens", ["/rosbridge"], ["/base"], HEARD],
  ["is none where nothing listens", ["/rosbridge"], [], UNHEARD],
  ["may have got to what no rosapi of ROS 2 sees", ["/rosbridge"], [], UNSEEN, "std_msgs/msg/Bool"],
  ["counts where rosapi hides the topic", [], [], HEARD],
  ["counts where rosapi does not say", undefined, undefined, HEARD],
]) {
  test(`what was published ${name}`, async () => {
    drive();
    lights.button = { ...LIGHTS, topic: "lights", type };
    press(lights);
    for (const kind of ["publishers", "subscribers"]) assert.ok(calls.some(({ how: [service] }) => service === `/rosapi/${kind}`));
    await answer(0, { publishers });
    await answer(1, { subscribers });
    await settle();
    assert.equal(lights.words, words);
  });
}

test("a press while an answer is awaited sends nothing more", () => {
  drive();
  press(scan);
  press(scan);
  assert.equal(calls.length, 1);
  assert.deepEqual(calls[0].how, ["/scan", { n: 1 }, undefined, 31]);
});

for (const [answer, does, words] of [
  [{ ok: true, values: {} }, true, ""],
  [{ ok: true, values: null }, true, ""],
  [{ ok: true, values: { success: true } }, true, ""],
  [{ ok: true, values: { sum: 3 } }, true, '{"sum":3}'],
  [{ ok: true, values: { success: true, message: "docked" } }, true, "docked"],
  [{ ok: true, values: { success: false } }, false, ""],
  [{ ok: false, values: "service /x does not exist" }, false, "service /x does not exist"],
]) {
  test(`an answer ${JSON.stringify(answer)} is its message, its other values, or a text`, () => {
    assert.deepEqual([succeeded(answer), answerWords(answer)], [does, words]);
  });
}

test("what a robot says is cut before it fills the page", () => {
  assert.equal(answerWords({ values: { message: "x".repeat(1000) } }).length, 301);
  assert.deepEqual([refusalWords("x".repeat(1000)).length, refusalWords(undefined)], [301, ""]);
});
