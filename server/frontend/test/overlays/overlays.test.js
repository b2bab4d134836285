import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { part } from "../../src/dom/page.js";
import { Diagnostics, Overlays, readLevel } from "../../src/overlays/overlays.js";
import { FakeElement } from "../fakes.js";

const DIAGNOSTICS = { name: "/diagnostics", type: "diagnostic_msgs/DiagnosticArray" };

let clock, root, specs, handlers, overlays;

beforeEach(() => {
  clock = 0;
  specs = [];
  handlers = {};
  root = new FakeElement();
  const subscribe = (spec, handler) => {
    specs.push(spec);
    handlers[spec.name] = handler;
    return () => delete handlers[spec.name];
  };
  overlays = new Overlays(root, { subscribe, now: () => clock });
});

for (const [online, battery, ...expected] of [
  [true, { percent: 12, charging: false }, "12 %, low", "poor"],
  [true, { percent: 30, charging: false }, "30 %", "fair"],
  [true, { percent: 12, charging: true }, "12 %, charging", "good"],
  [true, { percent: null, charging: false }, "?", ""],
  [true, null, "-", ""],
  [false, { percent: 80, charging: false }, "-", ""],
]) {
  test(`the battery of a robot that is ${online ? "online" : "offline"} and says ${JSON.stringify(battery)}: ${expected}`, () => {
    overlays.showBattery({ online, battery });
    const { textContent, dataset } = part(root, "battery");
    assert.deepEqual([textContent, dataset.health], expected);
  });
}

test("the same topic is subscribed to once, and each node's part waits instead of being lost", () => {
  overlays.follow({ diagnostics: DIAGNOSTICS });
  overlays.follow({ diagnostics: DIAGNOSTICS });
  assert.equal(specs.length, 1);
  assert.ok(specs[0].queueLength > 1);
  overlays.follow({});
  assert.deepEqual(Object.keys(handlers), []);
});

const status = (name, level, message = "") => ({ status: [{ name, level, message }] });

test("a level is a number, or a byte as bridges write it", () => {
  assert.deepEqual([0, 1, 2, 3].map(readLevel), ["ok", "warn", "error", "stale"]);
  assert.deepEqual(["AA==", "Ag==", "\u0001", "2"].map(readLevel), ["ok", "error", "warn", "error"]);
  assert.deepEqual([7, "?!", null, undefined, {}].map(readLevel), ["stale", "stale", "stale", "stale", "stale"]);
});

test("the newest of each name counts, and the worst comes first", () => {
  const diagnostics = new Diagnostics();
  diagnostics.receive(status("motor", 2, "hot"), 0);
  diagnostics.receive(status("camera", 1), 0);
  diagnostics.receive(status("disk", 1), 0);
  assert.deepEqual(diagnostics.worst(10), { level: "error", count: 1 });
  diagnostics.receive(status("motor", 0, "cool"), 100);
  assert.deepEqual(diagnostics.worst(200), { level: "warn", count: 2 });
  const names = diagnostics.list(200).map(({ name }) => name);
  assert.deepEqual(names, ["camera", "disk", "motor"]);
});

test("what is no status is left out, and the others count", () => {
  const diagnostics = new Diagnostics();
  for (const status of [null, 5, [null, { name: 3 }, { name: "motor", level: 2 }]]) diagnostics.receive({ status }, 0);
  assert.deepEqual(diagnostics.list(0), [{ name: "motor", level: "error", message: "" }]);
});

test("nothing is known before the first message, nor of a part that says nothing for ten seconds", () => {
  const diagnostics = new Diagnostics();
  assert.equal(diagnostics.worst(0), null);
  diagnostics.receive(status("motor", 0), 0);
  assert.equal(diagnostics.worst(10_001).level, "stale");
});

test("a list that is cut says what is left out", () => {
  const list = { replaceChildren: (...rows) => (list.rows = rows) };
  globalThis.document = { createElement: () => new FakeElement() };
  overlays.details.querySelector = () => list;
  overlays.diagnostics.receive({ status: Array.from({ length: 75 }, (_, i) => ({ name: `part ${i}`, level: 2 })) }, 0);
  overlays.showList();
  assert.deepEqual([list.rows.length, list.rows.at(-1).children[0]], [61, "15 more, none of them worse"]);
});

test("of names without end the newest count, and it is said", () => {
  const { diagnostics } = overlays;
  diagnostics.receive({}, 0);
  for (let i = 0; i < 1000; i++) diagnostics.receive(status(`part ${i}`, 0), 0);
  assert.equal(diagnostics.list(0).length, 500);
  diagnostics.receive(status("motor", 2), 0);
  assert.deepEqual([diagnostics.list(0).length, diagnostics.worst(0).level], [500, "error"]);
  overlays.show();
  assert.equal(part(overlays.details, "diagnostics-worst").textContent, "1 error, of the newest 500 parts");
});
