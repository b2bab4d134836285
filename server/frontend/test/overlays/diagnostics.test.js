import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Diagnostics, readLevel } from "../../src/overlays/overlays.js";

let diagnostics;
const status = (name, level, message = "") => ({ status: [{ name, level, message }] });

beforeEach(() => {
  diagnostics = new Diagnostics();
});

test("a level is a number, or a byte as bridges write it", () => {
  assert.deepEqual([0, 1, 2, 3].map(readLevel), ["ok", "warn", "error", "stale"]);
  assert.deepEqual(["AA==", "Ag==", "\u0001", "2"].map(readLevel), ["ok", "error", "warn", "error"]);
  assert.deepEqual([7, "?!", null, undefined, {}].map(readLevel), ["stale", "stale", "stale", "stale", "stale"]);
});

test("the newest of each name counts, and the worst comes first", () => {
  diagnostics.receive(status("motor", 2, "hot"), 0);
  diagnostics.receive(status("camera", 1), 0);
  diagnostics.receive(status("disk", 1), 0);
  assert.deepEqual(diagnostics.worst(10), { level: "error", count: 1 });
  diagnostics.receive(status("motor", 0, "cool"), 100);
  assert.deepEqual(diagnostics.worst(200), { level: "warn", count: 2 });
  assert.deepEqual(
    diagnostics.list(200).map(({ name }) => name),
    ["camera", "disk", "motor"],
  );
});

test("a part that says nothing for ten seconds is silent, however well it was", () => {
  diagnostics.receive(status("motor", 0), 0);
  assert.equal(diagnostics.worst(10_001).level, "stale");
});

test("nothing is known before the first message, and names without end are bounded", () => {
  assert.equal(diagnostics.worst(0), null);
  diagnostics.receive({}, 0);
  for (let i = 0; i < 1000; i++) diagnostics.receive(status(`part ${i}`, 0), 0);
  assert.equal(diagnostics.list(0).length, 500);
});
