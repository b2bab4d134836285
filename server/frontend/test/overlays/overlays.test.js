import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Overlays } from "../../src/overlays/overlays.js";

const BATTERY = { name: "/battery_state", type: "sensor_msgs/BatteryState" };
const DIAGNOSTICS = { name: "/diagnostics", type: "diagnostic_msgs/DiagnosticArray" };

let clock, parts, specs, handlers, overlays;

// Elements as far as the readouts use them.
const element = () => ({ dataset: {}, hidden: true, textContent: "", open: false, addEventListener() {} });

beforeEach(() => {
  clock = 0;
  specs = [];
  handlers = {};
  parts = { battery: element(), diagnostics: element(), "diagnostics-worst": element() };
  const query = { querySelector: (selector) => parts[/"(.+)"/.exec(selector)[1]] };
  Object.assign(parts.diagnostics, query);
  const subscribe = (spec, handler) => {
    specs.push(spec);
    handlers[spec.name] = handler;
    return () => delete handlers[spec.name];
  };
  overlays = new Overlays(query, { subscribe, now: () => clock });
});

test("a battery is shown, low in words, and forgotten when it is silent", () => {
  overlays.follow({ battery: BATTERY });
  handlers["/battery_state"]({ percentage: 0.12 });
  assert.equal(parts.battery.textContent, "12 %, low");
  assert.equal(parts.battery.dataset.health, "poor");
  clock = 60_000;
  overlays.show();
  assert.equal(parts.battery.textContent, "-");
  assert.equal(parts.battery.dataset.health, "");
});

test("the worst of the diagnostics is shown", () => {
  overlays.follow({ diagnostics: DIAGNOSTICS });
  overlays.show();
  assert.equal(parts.diagnostics.hidden, true);
  handlers["/diagnostics"]({ status: [{ name: "motor", level: 2, message: "hot" }] });
  overlays.show();
  assert.equal(parts.diagnostics.dataset.level, "error");
  assert.equal(parts["diagnostics-worst"].textContent, "1 error");
});

test("the same topics are subscribed to once, and each node's part waits instead of being lost", () => {
  overlays.follow({ battery: BATTERY, diagnostics: DIAGNOSTICS });
  overlays.follow({ battery: BATTERY, diagnostics: DIAGNOSTICS });
  assert.equal(specs.length, 2);
  assert.ok(specs[1].queueLength > 1);
  overlays.follow({ battery: BATTERY });
  assert.deepEqual(Object.keys(handlers), ["/battery_state"]);
});
