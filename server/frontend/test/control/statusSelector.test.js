import assert from "node:assert/strict";
import { test } from "node:test";

import { afterTicketRefusal } from "../../src/client/connection.js";
import { isSlow, selectStatus, silenceOf } from "../../src/control/controlPanel.js";
import { connection, states } from "../../src/texts/common.js";

const texts = { ...connection, ...states };
const LIVE = { name: "live" };
const FINE = { control: { stopped: null, guard: "ready" }, driving: true, video: "seen" };

function shown(state, facts) {
  const name = selectStatus(state, facts);
  assert.ok(name in texts, name);
  return name;
}

test("without a connection its own state is shown, whatever was true before", () => {
  const control = { stopped: { by: "ben", confirmed: true }, guard: "down" };
  assert.equal(shown({ name: "offline" }, { control, driving: true, video: "old" }), "offline");
});

test("a robot that an administrator disabled is not one that comes back by itself", () => {
  for (const name of ["offline", "link_lost"]) assert.equal(shown({ name }, { disabled: true }), "disabled");
  for (const name of ["live", "not_allowed", "server_unreachable"]) assert.equal(shown({ name }, { disabled: true }), name);
});

test("a robot that is gone is no matter of rights, and one with another name is told by it", () => {
  const gone = afterTicketRefusal({ status: 404, code: "robot_unknown" });
  assert.equal(shown(gone, { disabled: true }), "gone");
  assert.equal(shown(gone, { renamed: "crane" }), "renamed");
  assert.match(states.gone.detail(gone), /renamed/);
  assert.match(states.renamed.detail({ renamed: "crane" }), /crane/);
  assert.equal(shown(afterTicketRefusal({ status: 403, code: "grant_missing" }), { renamed: "" }), "not_allowed");
});

test("a stop comes before all else, and says whether the robot has confirmed it", () => {
  const stopped = { by: "ben", at: "", confirmed: false };
  assert.equal(shown(LIVE, { ...FINE, control: { stopped, guard: "down" }, video: "old" }), "stopping");
  stopped.confirmed = true;
  assert.equal(shown(LIVE, { ...FINE, control: { stopped, guard: "down" } }), "stopped");
});

test("then comes a guard that does not answer, then a picture that is missing", () => {
  assert.equal(shown(LIVE, { ...FINE, control: { guard: "down" }, video: "old" }), "guard_down");
  assert.equal(shown(LIVE, { ...FINE, video: "old" }), "held");
  assert.equal(shown(LIVE, { ...FINE, video: "missing" }), "held");
  assert.equal(shown(LIVE, { ...FINE, video: "blind" }), "blind");
  assert.equal(shown(LIVE, FINE), "live");
  assert.equal(shown(LIVE, { ...FINE, video: "off" }), "live");
});

test("whoever watches is held by no picture", () => {
  assert.equal(shown(LIVE, { ...FINE, driving: false, video: "old" }), "live");
  assert.equal(shown(LIVE, { ...FINE, driving: false, slow: true }), "live");
});

test("who drives over a network that is too slow is told why nothing moves", () => {
  assert.equal(shown(LIVE, { ...FINE, slow: true }), "slow");
  assert.equal(shown(LIVE, { ...FINE, slow: true, video: "blind" }), "slow");
  assert.equal(shown(LIVE, { ...FINE, slow: true, video: "old" }), "held");
});

test("a network is too slow when half the way there and back is more than the guard allows", () => {
  assert.equal(isSlow({ server: 500, robot: 501 }, 500), true);
  assert.equal(isSlow({ server: 500, robot: 501 }, 800), false);
  assert.equal(isSlow({ server: 500, robot: 500 }, 500), false);
  for (const unknown of [
    { server: null, robot: 5 },
    { server: 5, robot: undefined },
  ])
    assert.equal(isSlow(unknown, 500), false);
});

test("each state has its own title and says what it means", () => {
  const all = Object.keys(texts);
  assert.equal(new Set(all.map((name) => texts[name].title)).size, all.length);
  const facts = { since: "12:03", video: "old", stopped: { by: "ben", at: "12:03" }, mayDrive: true };
  for (const name of all) assert.notEqual(texts[name].detail(facts), "", name);
});

test("silence of server and video together is no frozen video, and offers no driving without it", () => {
  assert.equal(shown(LIVE, { ...FINE, video: "old", silentS: 1 }), "silent");
  assert.equal(shown(LIVE, { ...FINE, driving: false, silentS: 1 }), "silent");
  assert.equal(shown(LIVE, { ...FINE, control: { stopped: { confirmed: true } }, silentS: 1 }), "stopped");
  const { headline, detail, action } = states.silent;
  assert.equal(`${headline({ silentS: 3 })} ${detail(FINE)}`, "No connection for 3 s. The robot halts by itself.");
  assert.equal(action, undefined);
  assert.match(detail({ control: { guard: "off" } }), /does not stop by itself/);
  assert.match(detail({ control: { guard: "unknown" } }), /not known/);
});

test("silence counts from when the later of both came, in whole seconds", () => {
  assert.equal(silenceOf(999, 5000), 0);
  assert.equal(silenceOf(5000, 400), 0);
  assert.equal(silenceOf(1000, 5000), 1);
  assert.equal(silenceOf(3999, null), 3);
});
