import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import { lease, release } from "../../src/pages/calls.js";

const { document, fetch } = globalThis;

let sent;

beforeEach(() => {
  sent = [];
  globalThis.document = { querySelector: () => ({ content: "csrf" }) };
  globalThis.fetch = async (path, { body }) => {
    sent.push([path, JSON.parse(body)]);
    return new Response('{"code": "not_possible", "detail": "look again"}', { status: 409 });
  };
});

afterEach(() => Object.assign(globalThis, { document, fetch }));

test("a release names the stop that its person saw", async () => {
  const stopped = { by: "ben", at: "2026-01-01T12:03:00Z", confirmed: true };
  const answer = await release("sim1", stopped);
  assert.deepEqual(sent, [["/api/v1/robots/sim1/release", { by: "ben", at: stopped.at }]]);
  assert.equal(answer.ok, false);
  assert.equal(answer.detail, "look again");
});

test("only a hand-over names somebody", async () => {
  await lease("sim1", "hand_over", { to: "ben" });
  await lease("sim1", "refuse");
  assert.deepEqual(
    sent.map(([, body]) => body),
    [{ action: "hand_over", to: "ben" }, { action: "refuse" }],
  );
});
