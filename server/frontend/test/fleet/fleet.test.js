import assert from "node:assert/strict";
import { describe, mock, test } from "node:test";

import { part } from "../../src/dom/page.js";
import { healthText, robotOf } from "../../src/fleet/cards.js";
import { CardStop, FleetStops, outcome } from "../../src/fleet/fleetStops.js";
import { PointerPause } from "../../src/fleet/list.js";
import { nearestOf, showNearest } from "../../src/fleet/nearest.js";
import { MovingHand, heirs, keyOfPress, keysFor, requestsByRobot, wallNames } from "../../src/fleet/wall.js";
import { FakeElement, settle } from "../fakes.js";

const AWAY = { state: "active", online: false, since: null, ros: "down", video: "down" };

const battery = (percent) => ({ online: true, battery: { percent, charging: false } });

// What calls for attention.
for (const [robot, health] of [
  [{ online: true, ros: "ok", video: "unknown" }, ""],
  [{ online: true, ros: "down", video: "down" }, "rosbridge does not answer, video does not answer"],
  [{ online: true, control: { guard: "down" } }, "its guard does not answer"],
  [{ online: true, control: { guard: "off" } }, ""],
  [battery(12), "battery low"],
  [{ online: true, battery: null }, ""],
  [{ ...battery(12), online: false }, "It is not known why."],
  [{ ...AWAY, offline_reason: "The robot went silent." }, "The robot went silent."],
  [robotOf({ online: "false", offlineReason: "The server stopped." }), "The server stopped."],
]) {
  test(`a card says of ${JSON.stringify(robot)}: ${health}`, () => assert.equal(healthText(robot), health));
}

const robot = (name, online = true) => ({ name, mac: `of ${name}`, online });
const asks = (name, robot = name) => ({ robot, mac: `of ${name}` });

test("robots that ask for help stand first, as their requests come, then those online, as many as a person watches", () => {
  const robots = [robot("a", false), ...Array.from({ length: 30 }, (_, place) => robot(`r${place}`)), robot("z", false)];
  const byRobot = requestsByRobot([asks("z", "a"), asks("r29"), asks("z"), asks("not-seen")]);
  const names = wallNames(robots, byRobot, 8);
  assert.equal(names.length, 8);
  assert.deepEqual(names.slice(0, 4), ["z", "r29", "r0", "r1"]);
  assert.deepEqual(wallNames([robot("a", false), robot("b")], new Map()), ["b", "a"]);
});

test("a robot keeps its key wherever it moves, and one that comes gets one that is free", () => {
  const before = keysFor(["a", "b", "c"]);
  assert.deepEqual(Object.fromEntries(before), { a: "1", b: "2", c: "3" });
  const after = keysFor(["d", "c", "a"], before);
  assert.deepEqual(Object.fromEntries(after), { a: "1", c: "3", d: "2" });
});

test("a robot that comes to another's place, or gets its key, is an heir", () => {
  const before = { names: ["a", "b"], keys: keysFor(["a", "b"]) };
  const names = ["c", "a", "d"];
  assert.deepEqual(heirs(names, keysFor(names, before.keys), before), { places: ["c", "a"], keys: ["c"] });
  assert.deepEqual(heirs(names, keysFor(names), { names: [], keys: new Map() }), { places: [], keys: [] });
});

for (const [press, key] of [
  [{ key: "3", code: "Digit3" }, "3"],
  [{ key: '"', code: "Digit3" }, "3"], // a French keyboard
  [{ key: "0", code: "Numpad0" }, "0"],
  [{ key: "Q", code: "KeyQ" }, "q"],
  [{ key: "z", code: "KeyZ" }, ""],
  [{ key: "Enter", code: "Enter" }, ""],
  [{ key: "3", code: "Digit3", ctrlKey: true }, ""],
  [{ key: "3", code: "Digit3", repeat: true }, ""],
]) {
  test(`the press ${JSON.stringify(press)} takes the robot of the key ${key || "none"}`, () => assert.equal(keyOfPress(press), key));
}

test("a hand that moves keeps the robots where they are, and one that rests does not", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  let now = 0;
  const onRest = mock.fn();
  const hand = new MovingHand({ onRest, now: () => now });
  const wall = new EventTarget();
  hand.listen(wall);
  assert.equal(hand.moves, false);
  wall.dispatchEvent(new Event("pointermove"));
  assert.equal(hand.moves, true);
  now = 3000;
  t.mock.timers.tick(3000);
  assert.deepEqual([hand.moves, onRest.mock.callCount()], [false, 1]);
});

const [a, b] = [
  { name: "a", authority: "a.example" },
  { name: "b", authority: "b.example:8443" },
];

const CASES = [
  [95, [70, 18], b],
  [95, [null, 18], b],
  [20, [15, 1], {}], // 19 ms less
  [200, [170, 161], {}], // less than a fifth
  [100, [80, 90], a],
  [95, [null, null], {}],
  [null, [5, 5], {}],
];
for (const [here, others, expected] of CASES) {
  test(`with ${here} ms here and ${others} ms elsewhere, ${expected.name ?? "no machine"} is nearer`, () => {
    assert.deepEqual(nearestOf(here, [a, b], others).machine ?? {}, expected);
  });
}

test("the shortest of three round trips counts, and of a machine that falls silent the last that it answered", async (context) => {
  let clock = 0;
  const tookMs = [90, 20, 100];
  context.mock.method(performance, "now", () => clock);
  context.mock.method(globalThis, "fetch", async () => {
    if (!tookMs.length) throw new TypeError("no answer");
    clock += tookMs.shift() ?? 0;
  });
  const element = Object.assign(new FakeElement(), { dataset: { machines: "[]" } });
  for (const [rest, words] of /** @type {[number[], RegExp][]} */ ([
    [[90, 20, 100], /\(20 ms\)/],
    [[70], /\(70 ms\)/],
    [[], /^It is not known/],
  ])) {
    tookMs.splice(0, Infinity, ...rest);
    await showNearest(element);
    assert.match(element.textContent, words);
  }
});

test("a finger disturbs a list for three seconds after it has touched", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  let now = 10_000;
  const onEnd = mock.fn();
  const list = Object.assign(new EventTarget(), { querySelector: () => null });
  const pause = new PointerPause({ onEnd, now: () => now });
  pause.listen(list);
  for (const name of ["pointerover", "pointerdown"]) list.dispatchEvent(Object.assign(new Event(name), { pointerType: "touch" }));
  now += 2999;
  t.mock.timers.tick(2999);
  assert.equal(pause.active, true);
  const before = onEnd.mock.callCount();
  now += 1;
  t.mock.timers.tick(1);
  assert.deepEqual([pause.active, onEnd.mock.callCount()], [false, before + 1]);
});

describe("stops", () => {
  function open() {
    const root = new FakeElement();
    return { root, stops: new FleetStops(root, { manages: true }) };
  }

  test("what became of a stop follows the robot's own news", () => {
    const answer = { name: "sim1", stopped: true, confirmed: false };
    assert.match(outcome(answer, undefined), /not confirmed/);
    assert.match(outcome(answer, { control: { stopped: { confirmed: false } } }), /not confirmed/);
    assert.equal(outcome(answer, { control: { stopped: { confirmed: true } } }), "sim1: stopped");
    assert.match(outcome({ ...answer, stopped: false }, { control: { stopped: null } }), /not stopped/);
  });

  globalThis.document = { createElement: () => new FakeElement(), querySelector: () => ({ content: "" }) };

  test("a robot that was released is no longer among those that a stop has stopped", () => {
    const { root, stops } = open();
    const robot = (name, stopped) => ({ name, mac: `mac of ${name}`, control: { stopped } });
    stops.results = ["sim1", "sim2"].map((name) => ({ name, mac: `mac of ${name}`, stopped: true, confirmed: false }));
    const names = () => stops.results.map(({ name }) => name);
    stops.receive([robot("sim1", null), robot("sim2", { confirmed: true })]);
    assert.deepEqual(names(), ["sim1", "sim2"]); // the news of a stop may come after its answer
    stops.receive([robot("sim1", { confirmed: true }), robot("sim2", null)]);
    assert.deepEqual(names(), ["sim1"]);
    stops.receive([robot("sim1", null)]);
    assert.deepEqual([names(), part(root, "stop-result").children], [[], []]);
  });

  test("what became of a stop follows the robot, not its name, which another robot may get", () => {
    const { root, stops } = open();
    const robot = (name, mac, confirmed) => ({ name, mac, control: { stopped: { confirmed } } });
    stops.receive([robot("sim1", "mac 1", false), robot("sim2", "mac 2", true)]);
    stops.results = [{ name: "sim1", mac: "mac 1", stopped: true, confirmed: false }];
    stops.receive([robot("sim2", "mac 1", false), robot("sim1", "mac 2", true)]);
    const [line] = part(root, "stop-result").children[0].children.map(({ children }) => children[0]);
    assert.match(line, /^sim2: .*not confirmed/);
  });

  test("who manages some of the robots reads that the others were left out", () => {
    const { root, stops } = open();
    const robot = (name, level, site, stopped = null) => ({ name, mac: name, level, site, control: { stopped } });
    const words = () => part(root, "stops").children.map(({ children }) => children[0]);
    const lines = (site) => {
      stops.site = site;
      stops.settle(
        { ok: true, body: { robots: [{ name: "sim1", mac: "sim1", stopped: true, confirmed: true }], cells_unreached: [] } },
        site,
        1,
        1,
      );
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
    const { root, stops } = open();
    const robot = (confirmed) => ({ name: "sim1", mac: "sim1", level: "manage", control: { stopped: { confirmed } } });
    const lines = () => part(root, "stop-result").children[0].children.map(({ children }) => children[0]);
    const robots = [{ name: "sim1", mac: "sim1", stopped: true, confirmed: false }];
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
      return new Response(JSON.stringify({ robots: [], cells_unreached: [] }), { status });
    });
    const { root, stops } = open();
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
    const card = new FakeElement();
    stop.join(card);
    part(card, "stop").dispatchEvent(new Event("click"));
    await settle();
    const { searchParams } = new URL(asked.mock.calls[0].arguments[0], "https://server");
    assert.equal(searchParams.get("mac"), "00:1b:44:11:3a:b7");
    clearTimeout(stop.stopping.timer);
    mock.restoreAll();
  });
});
