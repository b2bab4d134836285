import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Seat } from "../src/seat.js";

const SINCE = "2026-01-01T12:03:00Z";
const ann = { user: "ann", since: SINCE, fence: 1 };
const ben = { user: "ben", since: SINCE, passes_at: SINCE };
const me = { user: "me", since: SINCE, passes_at: SINCE };
const stopped = { by: "ben", at: SINCE, confirmed: true };

let moves, seat;

function sitDown(level, drove = { armed: true }) {
  moves = [];
  seat = new Seat({ me: "me", level, drove, onMove: () => moves.push(seat.mode) });
}

beforeEach(() => sitDown("drive"));

function askAnn() {
  seat.lose("lease_held", "");
  seat.hear({ driver: ann });
  seat.ask();
  seat.hear({ driver: ann, waiting: me });
}

test("a page that is opened watches, whoever opens it", () => {
  for (const level of ["observe", "drive", "manage"]) {
    sitDown(level, null);
    assert.equal(seat.mode, "observe");
    assert.equal(seat.armed, false);
    seat.hear({ driver: null });
    assert.deepEqual(moves, []);
  }
});

test("a page that is loaded anew while it drove drives on, armed if it was", () => {
  assert.equal(seat.mode, "drive");
  assert.deepEqual(seat.kept, { armed: true });
  sitDown("drive", { armed: false });
  assert.equal(seat.mode, "drive");
  assert.equal(seat.armed, false);
  seat.leave();
  assert.equal(seat.kept, null);
});

test("who may no longer drive watches, whatever the page did before", () => {
  sitDown("observe");
  assert.equal(seat.mode, "observe");
  assert.deepEqual(seat.deeds(true), []);
});

for (const why of ["superseded", "robot_stopped", "lease_held", "lease_lost"]) {
  test(`after ${why} the page watches, not armed, and does not come back by itself`, () => {
    seat.lose(why, "reason");
    assert.equal(seat.mode, "observe");
    assert.equal(seat.armed, false);
    seat.hear({ driver: null });
    seat.hear({ driver: null, reserved: me });
    assert.equal(seat.mode, "observe");
    assert.deepEqual(moves, []);
  });
}

test("control that is kept for who asked is taken, not armed, and drives after a word of the person", () => {
  askAnn();
  seat.hear({ driver: null, reserved: me });
  assert.deepEqual(moves, ["drive"]);
  assert.equal(seat.armed, false);
  assert.equal(seat.note.why, "arrived");
  assert.deepEqual(seat.deeds(true), ["arm", "leave"]);
  seat.arm();
  assert.equal(seat.armed, true);
});

test("control that comes before the question was seen standing is taken as well", () => {
  seat.lose("lease_held", "");
  seat.ask();
  seat.hear({ driver: null, reserved: me });
  assert.deepEqual(moves, ["drive"]);
});

test("a driver who leaves leaves the control to who asked", () => {
  askAnn();
  seat.hear({ driver: null });
  assert.deepEqual(moves, ["drive"]);
  assert.equal(seat.armed, false);
});

test("a question that is gone while the driver stays was refused", () => {
  askAnn();
  seat.hear({ driver: ann, waiting: null });
  assert.deepEqual(seat.note, { why: "refused", by: "ann" });
  assert.equal(seat.asked, null);
  seat.hear({ driver: null, reserved: me });
  assert.deepEqual(moves, []);
});

test("news from before the question is no refusal", () => {
  seat.lose("lease_held", "");
  seat.ask();
  seat.hear({ driver: ann });
  assert.equal(seat.asked, "sent");
});

test("a question that was withdrawn brings no control", () => {
  askAnn();
  seat.forget();
  seat.hear({ driver: null, reserved: me });
  assert.deepEqual(moves, []);
});

test("a stop ends the question, whatever else the news says", () => {
  askAnn();
  seat.hear({ driver: null, stopped });
  assert.equal(seat.asked, null);
  assert.equal(seat.note.why, "stopped_meanwhile");
  assert.deepEqual(moves, []);
});

test("a question answered for another window of the same person ends here", () => {
  askAnn();
  seat.hear({ driver: { ...ann, user: "me" } });
  assert.equal(seat.asked, null);
  assert.deepEqual(moves, []);
});

test("who drove when the robot was stopped drives on by releasing it", () => {
  seat.lose("robot_stopped", "");
  seat.hear({ stopped });
  assert.equal(seat.wasStopped, true);
  seat.released(true);
  assert.deepEqual(moves, ["drive"]);
  assert.equal(seat.armed, true);
});

test("for others a release leaves the control free", () => {
  sitDown("drive", null);
  seat.hear({ stopped });
  assert.equal(seat.wasStopped, false);
  seat.released(false);
  assert.deepEqual(moves, []);
  assert.equal(seat.mode, "observe");
});

test("who drove when the robot was stopped has no more claim on it once somebody released it", () => {
  seat.lose("robot_stopped", "");
  seat.hear({ stopped });
  seat.hear({ stopped: null });
  seat.hear({ stopped });
  assert.equal(seat.wasStopped, false);
});

test("a press takes the control that nobody has, and says so", () => {
  sitDown("drive", null);
  seat.hear({ driver: null });
  assert.equal(seat.free, true);
  assert.equal(seat.press(), true);
  assert.deepEqual(moves, ["drive"]);
  assert.equal(seat.armed, true);
  assert.equal(seat.note.why, "pressed");
  seat.settle();
  assert.equal(seat.pressed, false);
});

test("a press before it is known who drives does nothing", () => {
  sitDown("drive", null);
  assert.equal(seat.press(), false);
  assert.deepEqual(seat.deeds(true), []);
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
    seat.hear(control);
    assert.equal(seat.free, false);
    assert.equal(seat.press(), false);
    assert.deepEqual(moves, []);
    assert.equal(seat.asked, null);
    assert.equal(seat.note.why, why);
    seat.hear(control);
    assert.equal(seat.note.why, why);
    seat.hear({ driver: null });
    assert.equal(seat.note, null);
  });
}

test("a press that lost the race for the control has to be made anew", () => {
  sitDown("drive", null);
  seat.hear({ driver: null });
  seat.press();
  seat.lose("lease_held", "");
  assert.equal(seat.pressed, false);
  assert.equal(seat.armed, false);
});

test("who takes the wheel by a press is armed at once", () => {
  seat.lose("superseded", "");
  seat.drive();
  assert.equal(seat.armed, true);
});

test("who gives up the control watches", () => {
  seat.leave();
  assert.deepEqual(moves, ["observe"]);
  assert.equal(seat.armed, false);
  assert.equal(seat.note.why, "left");
});

test("only the driver's own page is asked", () => {
  seat.hear({ driver: { ...ann, user: "me" }, waiting: ben });
  assert.equal(seat.asking.user, "ben");
  seat.lose("superseded", "");
  assert.equal(seat.asking, null);
});

test("that the robot was stopped is said until it is released", () => {
  for (const note of [() => seat.lose("robot_stopped", ""), () => seat.say({ why: "stopped_meanwhile" })]) {
    note();
    seat.hear({ driver: null, stopped });
    assert.notEqual(seat.note, null);
    seat.hear({ driver: ann });
    assert.equal(seat.note, null);
  }
});

test("a page that is told nothing any more says of nobody that they drive or ask, and takes nothing", () => {
  askAnn();
  seat.end();
  assert.deepEqual([seat.control.driver, seat.asking, seat.note, seat.asked], [null, null, null, null]);
  seat.hear({ driver: null });
  assert.deepEqual([seat.mode, moves], ["observe", []]);
});

test("a release ends no note of something else", () => {
  seat.lose("lease_held", "");
  seat.hear({ driver: ann, stopped });
  seat.hear({ driver: ann });
  assert.equal(seat.note.why, "lease_held");
});

test("what can be done depends on who drives, who waits and whether the robot is stopped", () => {
  const offered = (control) => {
    seat.hear(control);
    return seat.deeds(true);
  };
  seat.lose("lease_held", "");
  assert.deepEqual(offered({ driver: null }), ["drive"]);
  assert.deepEqual(offered({ driver: { ...ann, user: "me" } }), ["drive"]);
  assert.deepEqual(offered({ driver: null, reserved: ben }), []);
  assert.deepEqual(offered({ driver: ann }), ["ask"]);
  assert.deepEqual(offered({ driver: ann, waiting: ben }), []);
  assert.deepEqual(offered({ driver: null, stopped }), []);
  seat.ask();
  assert.deepEqual(offered({ driver: ann, waiting: me }), ["withdraw"]);
  assert.deepEqual(seat.deeds(false), []);
});

test("a manager can take the control, also while asking", () => {
  sitDown("manage");
  seat.lose("lease_held", "");
  seat.hear({ driver: ann });
  assert.deepEqual(seat.deeds(true), ["ask", "take"]);
  seat.ask();
  assert.deepEqual(seat.deeds(true), ["withdraw", "take"]);
});
