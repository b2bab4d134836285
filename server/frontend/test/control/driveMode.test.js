import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { DriveMode, ReloadStore } from "../../src/control/driveMode.js";
import { LocalStore } from "../../src/dom/page.js";
import { driveMode as notes } from "../../src/texts/common.js";

const SINCE = "2026-01-01T12:03:00Z";
const ann = { user: "ann", since: SINCE, fence: 1 };
const ben = { user: "ben", since: SINCE, passes_at: SINCE };
const me = { user: "me", since: SINCE, passes_at: SINCE };
const stopped = { by: "ben", at: SINCE, confirmed: true };

let moves, driveMode;

function sitDown(level, drove = { armed: true }) {
  moves = [];
  driveMode = new DriveMode({ me: "me", level, drove, onMove: () => moves.push(driveMode.mode) });
}

beforeEach(() => sitDown("drive"));

function askAnn() {
  driveMode.lose("lease_held", "");
  driveMode.receive({ driver: ann });
  driveMode.ask();
  driveMode.receive({ driver: ann, waiting: me });
}

test("a page that is opened watches, whoever opens it, as does one whose person may no longer drive", () => {
  for (const level of ["observe", "drive", "manage"]) {
    sitDown(level, null);
    assert.equal(driveMode.mode, "observe");
    assert.equal(driveMode.armed, false);
    driveMode.receive({ driver: null });
    assert.deepEqual(moves, []);
  }
  sitDown("observe");
  assert.deepEqual([driveMode.mode, driveMode.actions(true)], ["observe", []]);
});

test("a page that is loaded anew while it drove drives on, armed if it was", () => {
  assert.equal(driveMode.mode, "drive");
  assert.deepEqual(driveMode.saved, { armed: true });
  sitDown("drive", { armed: false });
  assert.equal(driveMode.mode, "drive");
  assert.equal(driveMode.armed, false);
  driveMode.leave();
  assert.equal(driveMode.saved, null);
});

for (const why of ["superseded", "robot_stopped", "lease_held", "lease_lost"]) {
  test(`after ${why} the page watches, not armed, and does not come back by itself`, () => {
    driveMode.lose(why, "reason");
    assert.equal(driveMode.mode, "observe");
    assert.equal(driveMode.armed, false);
    driveMode.receive({ driver: null });
    driveMode.receive({ driver: null, reserved: me });
    assert.equal(driveMode.mode, "observe");
    assert.deepEqual(moves, []);
  });
}

test("who handed the control over reads that, and not that somebody else has it", () => {
  driveMode.handedTo = "ben";
  driveMode.lose("lease_lost", "ben controls sim1 now");
  assert.deepEqual(driveMode.note, { why: "handed_over", by: "ben" });
  assert.match(notes.handed_over(driveMode.note), /^You handed control to ben\.$/);
  driveMode.drive();
  driveMode.lose("lease_lost", "ann controls sim1 now");
  assert.deepEqual(driveMode.note, { why: "lease_lost", reason: "ann controls sim1 now" });
});

test("control that is kept for who asked is taken, not armed, and drives after a word of the person", () => {
  driveMode.lose("lease_held", "");
  driveMode.ask(); // the question need not have been seen standing
  driveMode.receive({ driver: null, reserved: me });
  assert.deepEqual(moves, ["drive"]);
  assert.equal(driveMode.armed, false);
  assert.equal(driveMode.note.why, "arrived");
  assert.deepEqual(driveMode.actions(true), ["arm", "leave"]);
  driveMode.arm();
  assert.equal(driveMode.armed, true);
});

test("a driver who leaves leaves the control to who asked", () => {
  askAnn();
  driveMode.receive({ driver: null });
  assert.deepEqual(moves, ["drive"]);
  assert.equal(driveMode.armed, false);
});

test("a question that is gone while the driver stays was refused", () => {
  askAnn();
  driveMode.receive({ driver: ann, waiting: null });
  assert.deepEqual(driveMode.note, { why: "refused", by: "ann" });
  assert.equal(driveMode.asked, null);
  driveMode.receive({ driver: null, reserved: me });
  assert.deepEqual(moves, []);
});

test("news from before the question is no refusal", () => {
  driveMode.lose("lease_held", "");
  driveMode.ask();
  driveMode.receive({ driver: ann });
  assert.equal(driveMode.asked, "sent");
});

test("a question that was withdrawn brings no control", () => {
  askAnn();
  driveMode.withdraw();
  driveMode.receive({ driver: null, reserved: me });
  assert.deepEqual(moves, []);
});

test("who withdraws and asks again at once is not told of a refusal", () => {
  askAnn();
  driveMode.withdraw();
  driveMode.ask();
  driveMode.receive({ driver: ann, waiting: null });
  assert.equal(driveMode.note, null);
  driveMode.receive({ driver: ann, waiting: me });
  assert.equal(driveMode.asked, "waiting");
});

test("a stop ends the question, whatever else the news says", () => {
  askAnn();
  driveMode.receive({ driver: null, stopped });
  assert.equal(driveMode.asked, null);
  assert.equal(driveMode.note.why, "stopped_meanwhile");
  assert.deepEqual(moves, []);
});

test("a question answered for another window of the same person ends here", () => {
  askAnn();
  driveMode.receive({ driver: { ...ann, user: "me" } });
  assert.equal(driveMode.asked, null);
  assert.deepEqual(moves, []);
});

test("who drove when the robot was stopped drives on by releasing it", () => {
  driveMode.lose("robot_stopped", "");
  driveMode.receive({ stopped });
  assert.equal(driveMode.wasStopped, true);
  driveMode.released(true);
  assert.deepEqual(moves, ["drive"]);
  assert.equal(driveMode.armed, true);
});

test("for others a release leaves the control free", () => {
  sitDown("drive", null);
  driveMode.receive({ stopped });
  assert.equal(driveMode.wasStopped, false);
  driveMode.released(false);
  assert.deepEqual(moves, []);
  assert.equal(driveMode.mode, "observe");
});

test("who drove when the robot was stopped has no more claim on it once somebody released it", () => {
  driveMode.lose("robot_stopped", "");
  driveMode.receive({ stopped });
  driveMode.receive({ stopped: null });
  driveMode.receive({ stopped });
  assert.equal(driveMode.wasStopped, false);
});

test("a press takes the control that nobody has, and says so", () => {
  sitDown("drive", null);
  driveMode.receive({ driver: null });
  assert.equal(driveMode.free, true);
  assert.equal(driveMode.press(), true);
  assert.deepEqual(moves, ["drive"]);
  assert.equal(driveMode.armed, true);
  assert.equal(driveMode.note.why, "pressed");
  driveMode.settle();
  assert.equal(driveMode.pressed, false);
});

test("a press before it is known who drives does nothing", () => {
  sitDown("drive", null);
  assert.equal(driveMode.press(), false);
  assert.deepEqual(driveMode.actions(true), []);
  assert.deepEqual(moves, []);
});

for (const [who, control, why] of [
  ["somebody else drives", { driver: ann }, "busy_driver"],
  ["another window of the same person drives", { driver: { ...ann, user: "me" } }, "busy_window"],
  ["somebody is about to drive", { reserved: ben }, "busy_reserved"],
  ["the robot is stopped", { stopped }, "busy_stopped"],
]) {
  test(`a press while ${who} takes and asks nothing, and says why until that changes`, () => {
    sitDown("drive", null);
    driveMode.receive(control);
    assert.equal(driveMode.free, false);
    assert.equal(driveMode.press(), false);
    assert.deepEqual(moves, []);
    assert.equal(driveMode.asked, null);
    assert.equal(driveMode.note.why, why);
    driveMode.receive(control);
    assert.equal(driveMode.note.why, why);
    driveMode.receive({ driver: null });
    assert.equal(driveMode.note, null);
  });
}

test("a press that lost the race for the control has to be made anew", () => {
  sitDown("drive", null);
  driveMode.receive({ driver: null });
  driveMode.press();
  driveMode.lose("lease_held", "");
  assert.equal(driveMode.pressed, false);
  assert.equal(driveMode.armed, false);
});

test("who gives up the control watches", () => {
  driveMode.leave();
  assert.deepEqual(moves, ["observe"]);
  assert.equal(driveMode.armed, false);
  assert.equal(driveMode.note.why, "left");
});

test("only the driver's own page is asked", () => {
  driveMode.receive({ driver: { ...ann, user: "me" }, waiting: ben });
  assert.equal(driveMode.asking.user, "ben");
  driveMode.lose("superseded", "");
  assert.equal(driveMode.asking, null);
});

test("that the robot was stopped is said until it is released", () => {
  for (const note of [() => driveMode.lose("robot_stopped", ""), () => driveMode.setNote({ why: "stopped_meanwhile" })]) {
    note();
    driveMode.receive({ driver: null, stopped });
    assert.notEqual(driveMode.note, null);
    driveMode.receive({ driver: ann });
    assert.equal(driveMode.note, null);
  }
});

test("a page that is told nothing any more says of nobody that they drive or ask, and takes nothing", () => {
  askAnn();
  driveMode.end();
  assert.deepEqual([driveMode.control.driver, driveMode.asking, driveMode.note, driveMode.asked], [null, null, null, null]);
  driveMode.receive({ driver: null });
  assert.deepEqual([driveMode.mode, moves], ["observe", []]);
});

test("a release ends no note of something else", () => {
  driveMode.lose("lease_held", "");
  driveMode.receive({ driver: ann, stopped });
  driveMode.receive({ driver: ann });
  assert.equal(driveMode.note.why, "lease_held");
});

test("what can be done depends on who drives, who waits and whether the robot is stopped", () => {
  const offered = (control) => {
    driveMode.receive(control);
    return driveMode.actions(true);
  };
  driveMode.lose("lease_held", "");
  assert.deepEqual(offered({ driver: null }), ["drive"]);
  assert.deepEqual(offered({ driver: { ...ann, user: "me" } }), ["drive"]);
  assert.deepEqual(offered({ driver: null, reserved: ben }), []);
  assert.deepEqual(offered({ driver: ann }), ["ask"]);
  assert.deepEqual(offered({ driver: ann, waiting: ben }), []);
  assert.deepEqual(offered({ driver: null, stopped }), []);
  driveMode.ask();
  assert.deepEqual(offered({ driver: ann, waiting: me }), ["withdraw"]);
  assert.deepEqual(driveMode.actions(false), []);
});

test("a manager can take the control, also while asking", () => {
  sitDown("manage");
  driveMode.lose("lease_held", "");
  driveMode.receive({ driver: ann });
  assert.deepEqual(driveMode.actions(true), ["ask", "take"]);
  driveMode.ask();
  assert.deepEqual(driveMode.actions(true), ["withdraw", "take"]);
});

test("who asked before a reload, or got no answer, can ask again and is waited for", () => {
  sitDown("drive", null);
  driveMode.receive({ driver: ann, waiting: me });
  assert.deepEqual(driveMode.actions(true), ["ask"]);
  driveMode.ask();
  assert.deepEqual(driveMode.actions(true), ["withdraw"]);
  driveMode.receive({ driver: ann, waiting: null });
  assert.deepEqual(driveMode.note, { why: "refused", by: "ann" });
  assert.deepEqual(moves, []);
});

test("a page that drives and waits for its robot can give the control up, and takes it no more when the robot is back", () => {
  assert.deepEqual(driveMode.actions(false), []);
  assert.deepEqual(driveMode.actions(false, true), ["leave"]);
  driveMode.leave();
  assert.equal(driveMode.mode, "observe");
  assert.deepEqual(driveMode.actions(false, true), []);
});

let store, clock, arrival;

beforeEach(() => {
  store = new Map();
  clock = 1000;
  arrival = "reload";
});

const storage = {
  getItem: (name) => store.get(name) ?? null,
  setItem: (name, text) => store.set(name, text),
  removeItem: (name) => store.delete(name),
};
const load = (robot = "sim1") => new ReloadStore(robot, { store: new LocalStore(() => storage), arrival: () => arrival, now: () => clock });

test("a page that drove when it was loaded anew is told so, once", () => {
  load().save({ armed: true });
  assert.equal(load().restore().armed, true);
  assert.equal(load().restore(), null);
});

test("a page that did not drive leaves nothing", () => {
  load().save(null);
  assert.equal(load().restore(), null);
});

test("nothing is kept for another robot, for later, or for a page that is opened", () => {
  load().save({ armed: true });
  assert.equal(load("sim2").restore(), null);
  clock += 20_000;
  assert.equal(load().restore(), null);
  load().save({ armed: true });
  arrival = "navigate";
  assert.equal(load().restore(), null);
  arrival = "reload";
  assert.equal(load().restore(), null);
});

test("Drive on another page is granted to the page that it opens, once and soon", () => {
  arrival = "navigate";
  load().save({ armed: true, asked: true });
  assert.equal(load("sim2").restore(), null);
  assert.equal(load().restore().armed, true);
  assert.equal(load().restore(), null);
  load().save({ armed: true, asked: true });
  clock += 20_000;
  assert.equal(load().restore(), null);
});
