import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { part } from "../../src/dom/page.js";
import { CardStop, FleetStops, outcome } from "../../src/fleet/fleetStops.js";
import { FakeElement, settle } from "../fakes.js";

test("what became of a stop follows the robot's own news", () => {
  const answer = { name: "sim1", stopped: true, confirmed: false };
  assert.match(outcome(answer, undefined), /not confirmed/);
  assert.match(outcome(answer, { stopped: { confirmed: false } }), /not confirmed/);
  assert.equal(outcome(answer, { stopped: { confirmed: true } }), "sim1: stopped");
  assert.match(outcome({ ...answer, stopped: false }, { stopped: null }), /not stopped/);
});

globalThis.document = { createElement: () => new FakeElement(), querySelector: () => ({ content: "" }) };

test("a robot that was released is no longer among those that a stop has stopped", () => {
  const root = new FakeElement();
  const stops = new FleetStops(root, { manages: true });
  const robot = (name, stopped) => ({ name, control: { stopped } });
  stops.results = ["sim1", "sim2"].map((name) => ({ name, stopped: true, confirmed: false }));
  const names = () => stops.results.map(({ name }) => name);
  stops.receive([robot("sim1", null), robot("sim2", { confirmed: true })]);
  assert.deepEqual(names(), ["sim1", "sim2"]); // the news of a stop may come after its answer
  stops.receive([robot("sim1", { confirmed: true }), robot("sim2", null)]);
  assert.deepEqual(names(), ["sim1"]);
  stops.receive([robot("sim1", null)]);
  assert.deepEqual([names(), part(root, "stop-result").children], [[], []]);
});

test("who manages some of the robots reads that the others were left out", () => {
  const root = new FakeElement();
  const stops = new FleetStops(root, { manages: true });
  const robot = (name, level, site, stopped = null) => ({ name, level, site, control: { stopped } });
  const words = () => part(root, "stops").children.map(({ children }) => children[0]);
  const lines = (site) => {
    stops.site = site;
    stops.settle({ ok: true, body: { robots: [{ name: "sim1", stopped: true, confirmed: true }] } }, site, 1, 1);
    return part(root, "stop-result").children[0].children.map(({ children }) => children[0]);
  };
  stops.show([robot("sim1", "manage", "lab"), robot("new", "", "lab")]);
  assert.deepEqual(words(), ["Stop all robots", "Stop site lab"]);
  assert.deepEqual(lines(), ["sim1: stopped"]);
  stops.show([robot("sim1", "manage", "lab"), robot("sim2", "drive", "yard"), robot("sim3", "observe", null, { confirmed: true })]);
  assert.deepEqual(words(), ["Stop all robots that you manage", "Stop site lab"]);
  assert.match(lines()[1], /^1 other robot was left out/);
  assert.deepEqual(lines("lab"), ["sim1: stopped"]);
});

test("a machine that the stop has not reached is named, until all robots have confirmed theirs", () => {
  const root = new FakeElement();
  const stops = new FleetStops(root, { manages: true });
  const robot = (confirmed) => ({ name: "sim1", level: "manage", control: { stopped: { confirmed } } });
  const lines = () => part(root, "stop-result").children[0].children.map(({ children }) => children[0]);
  const robots = [{ name: "sim1", stopped: true, confirmed: false }];
  stops.show([robot(false)]);
  stops.settle({ ok: true, body: { robots, cells_unreached: ["east"] } }, undefined, 1, 1);
  assert.match(lines()[1], /does not reach east/);
  stops.receive([robot(true)]);
  assert.deepEqual(lines(), ["sim1: stopped"]);
});

// Press Stop all, with the answers of the server; give what was said after each of them.
async function pressed(...answers) {
  mock.timers.enable({ apis: ["setTimeout"] });
  const asked = mock.method(globalThis, "fetch", async () => {
    const status = answers.shift();
    if (!status) throw new TypeError("no network");
    return new Response(JSON.stringify({ robots: [] }), { status });
  });
  const root = new FakeElement();
  const stops = new FleetStops(root, { manages: true });
  const said = [];
  await stops.stop();
  for (let seconds = 0; seconds < 20; seconds += 1) {
    said.push(part(root, "stop-result").textContent);
    mock.timers.tick(1000);
    await settle();
  }
  const times = asked.mock.callCount();
  mock.timers.reset();
  asked.mock.restore();
  return { said, times };
}

test("a stop of all that the server does not hear is said again, and the person reads that nothing is stopped", async () => {
  const { said, times } = await pressed(0, 503, 200);
  assert.match(said[0], /trying again/);
  assert.match(said[1], /trying again/);
  assert.match(said[2], /No robot to stop/);
  assert.equal(times, 3);
});

test("its attempts end after a while, or when the server refuses", async () => {
  const lost = await pressed();
  assert.equal(lost.times, 15);
  assert.match(lost.said.at(-1), /^Stop not confirmed/);
  const refused = await pressed(403);
  assert.equal(refused.times, 1);
  assert.match(refused.said[0], /^Not stopped/);
});

test("the stop of a card means the robot with its MAC, also when another one has its name by then", async () => {
  const asked = mock.method(globalThis, "fetch", () => Promise.reject(new Error("no network")));
  const stop = new CardStop("sim1");
  stop.receive({ mac: "00:1b:44:11:3a:b7", state: "active" });
  stop.stopping.press();
  await settle();
  const { searchParams } = new URL(asked.mock.calls[0].arguments[0], "https://server");
  assert.equal(searchParams.get("mac"), "00:1b:44:11:3a:b7");
  clearTimeout(stop.stopping.timer);
  mock.restoreAll();
});
