import assert from "node:assert/strict";
import { test } from "node:test";

import { afterClose, afterTicketRefusal } from "../../src/client/connection.js";
import { connection as texts } from "../../src/texts/common.js";

const shown = (code, wasLive = false) => {
  const { name, retry } = afterClose({ code, wasLive });
  assert.ok(name in texts, name);
  return `${name} ${retry ? "retry" : "final"}`;
};

test("each close code of the contract has its own state", () => {
  const states = { connecting: [4001], offline: [4503], rosbridge_down: [4504], lease_unavailable: [4510] };
  Object.assign(states, { link_lost: [1008, 1009, 4408, 4413, 4505], server_unreachable: [1001, 4429] });
  for (const [name, codes] of Object.entries(states)) for (const code of codes) assert.equal(shown(code), `${name} retry`);
});

test("each way to lose the control is distinguished", () => {
  const lost = [4002, 4003, 4009, 4010, 4505].map((code) => afterClose({ code }).lost);
  assert.deepEqual(lost, ["superseded", "robot_stopped", "lease_held", "lease_lost", undefined]);
});

test("a cut without a code is a lost link when it was live, else an unreachable server", () => {
  assert.equal(shown(1006, true), "link_lost retry");
  assert.equal(shown(1006, false), "server_unreachable retry");
});

test("the reason that the server wrote is shown, and what to do beside it", () => {
  for (const code of [1001, 1002, 1008, 1009, 1011, 4408, 4413, 4429, 4504, 4505, 4510]) {
    const { name, reason } = afterClose({ code, reason: "rosbridge on robot sim1 does not answer: its port 9091 is taken" });
    assert.match(texts[name].detail({ reason }), /^Rosbridge on robot sim1 does not answer: its port 9091 is taken\. \S/, code);
    const unsaid = texts[name].detail({ reason: afterClose({ code }).reason });
    assert.ok(unsaid && !unsaid.startsWith("."), code);
  }
});

test("a refused ticket ends the attempts only where another attempt cannot help", () => {
  const verdict = (status, code) => {
    const { name, retry, login } = afterTicketRefusal({ status, code });
    return { name, retry, login: Boolean(login) };
  };
  assert.deepEqual(verdict(401, "login_missing"), { name: "not_allowed", retry: false, login: true });
  assert.deepEqual(verdict(403, "grant_missing"), { name: "not_allowed", retry: false, login: false });
  assert.deepEqual(verdict(404, "robot_unknown"), { name: "not_allowed", retry: false, login: false });
  assert.deepEqual(verdict(400, ""), { name: "not_allowed", retry: false, login: false });
  const { reason } = afterTicketRefusal({ status: 403, code: "grant_missing", detail: "cannot drive robot sim1: your grant is observe" });
  assert.match(reason, /^Your grant is observe\. Reload/);
  for (const status of [0, 429, 500, 502, 503]) {
    assert.deepEqual(verdict(status, ""), { name: "server_unreachable", retry: true, login: false });
  }
});
