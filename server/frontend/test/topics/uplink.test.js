import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { part } from "../../src/dom/page.js";
import { TopicSwitch, Uplink, totalText, uplinkRows } from "../../src/topics/uplink.js";
import { FakeElement } from "../fakes.js";

globalThis.document = { createElement: () => new FakeElement(), addEventListener() {}, hidden: false };

const MAP = { kind: "topic", name: "/map", bytes_per_s: 118_000, people: 2, yours: true };
const CAMERA = { kind: "camera", name: "/a", bytes_per_s: 64_000, people: 1, yours: false };
const REST = { kind: "rosbridge", name: "", bytes_per_s: 300, people: 3, yours: true };

let root, answer, probes, topicSwitch, list;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout"] });
  root = Object.assign(new FakeElement(), { open: true });
  answer = { ok: true, body: { streams: [MAP, CAMERA, REST], line_bytes_per_s: null } };
  probes = { has: () => false, close: mock.fn() };
  topicSwitch = new TopicSwitch({ subscribe: () => {}, probes });
  list = new Uplink(root, { get: async () => answer, switches: { topic: topicSwitch } });
});

// What each row says of its stream.
const facts = () => part(root, "uplink-list").children.map((row) => part(row, "facts").textContent);

test("without an answer no number stays on the page", async () => {
  await list.renew();
  answer = { ok: false, detail: "robot sim1 is offline", body: {} };
  await list.renew();
  assert.equal(part(root, "uplink-total").textContent, "Not measured now. Robot sim1 is offline.");
  assert.deepEqual(facts(), ["Topic · ? B/s", "Camera · ? B/s", "? B/s"]);
});

test("what a recording reads is not said to be read by nobody", async () => {
  const streams = [{ people: 0 }, { people: 0, recorded: true }, { people: 1, yours: true, recorded: true }].map((readers, i) => ({
    ...CAMERA,
    name: `/${i}`,
    ...readers,
  }));
  answer = { ok: true, body: { streams: [MAP, ...streams], line_bytes_per_s: null } };
  await list.renew();
  const readers = facts().map((words) => words.split(" · ")[2]);
  assert.deepEqual(readers, ["you and 1 more", "nobody now", "only the recording", "you and the recording"]);
});

test("a rate that is not measured makes the sum unknown, and a full line is said to be", () => {
  assert.equal(totalText([MAP, { ...CAMERA, bytes_per_s: null }], null), "In all ? B/s.");
  const full = "In all 118 KB/s. The robot's line is full: it carries about 120 KB/s of video and topics.";
  assert.equal(totalText([MAP], 120_400), full);
});

test("a probe that a person opened is closed, and is not waited for", () => {
  probes.has = (name) => name === "/scan";
  const [{ offers }] = uplinkRows([{ ...MAP, name: "/scan" }], { topic: topicSwitch });
  assert.equal(offers, "off");
  topicSwitch.switchTo("/scan", false);
  assert.deepEqual([probes.close.mock.calls[0].arguments, topicSwitch.off.size], [["/scan"], 0]);
});
