import assert from "node:assert/strict";
import { test } from "node:test";

import { part } from "../../src/dom/page.js";
import { AskForHelp } from "../../src/queue/askForHelp.js";
import { FakeElement } from "../fakes.js";

globalThis.document = { createElement: () => new FakeElement(), activeElement: null };

test("a request that comes does not move the others, whose buttons may be under a finger", () => {
  const root = new FakeElement();
  const help = new AskForHelp(root, { robot: "sim1", level: "manage", me: "ann", post: async () => ({}), onAsked() {} });
  const request = (id, priority) => ({ id, priority, reason: `reason ${id}`, state: "waiting", age_s: 1 });
  help.receive([request(1, 2), request(2, 3)]);
  help.receive([request(3, 1), request(2, 1), request(1, 2)]); // the most urgent first
  const reasons = part(part(root, "help"), "help-list").children.map((item) => part(item, "reason").textContent);
  assert.deepEqual(reasons, ["reason 1", "reason 2", "reason 3"]);
});
