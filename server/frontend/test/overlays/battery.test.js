import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { BatteryReader } from "../../src/overlays/overlays.js";

let reader;

beforeEach(() => {
  reader = new BatteryReader();
});

test("a fraction becomes percent, and under twenty is low", () => {
  assert.deepEqual(reader.read({ percentage: 0.81, voltage: 12.34, power_supply_status: 2 }), {
    percent: 81,
    volts: 12.3,
    charging: false,
    low: false,
  });
  assert.equal(reader.read({ percentage: 0.19 }).low, true);
  assert.equal(reader.read({ percentage: 1 }).percent, 100);
});

test("a driver that counts to a hundred is understood, down to one", () => {
  assert.equal(reader.read({ percentage: 80 }).percent, 80);
  assert.equal(reader.read({ percentage: 1 }).percent, 1);
});

test("without a percentage the voltage is told, and without both nothing", () => {
  assert.deepEqual(reader.read({ percentage: null, voltage: 24.06 }), { percent: null, volts: 24.1, charging: false, low: false });
  assert.equal(reader.read({ percentage: NaN, voltage: NaN }), null);
  assert.equal(reader.read({ percentage: 0.5, present: false }), null);
});

test("charging and full are on the charger", () => {
  assert.equal(reader.read({ percentage: 0.5, power_supply_status: 1 }).charging, true);
  assert.equal(reader.read({ percentage: 1, power_supply_status: 4 }).charging, true);
});
