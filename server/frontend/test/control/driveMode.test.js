import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { DriveMode, ReloadStore } from "../../src/control/driveMode.js";
import { LocalStore } from "../../src/dom/page.js";
import { driveMode as notes } from "../../src/texts/common.js";
import { storageOf } from "../fakes.js";

const SINCE = "2026-01-01T12:03:00Z";
const ann = { user: "ann", since: SINCE, fence: 1 };
const ben = { user: "ben", since: SINCE, passes_at: SINCE };
const me = { user: "me", since: SINCE, passes_at: SINCE };
const mine = { ...ann, user: "me" };
const stopped = { by: "ben", at: SINCE, confirmed: true };

let moves, driveMode;

function sitDown(level = "drive", drove = null) {
  moves = [];
  driveMode = new DriveMode({ me: "me", level, drove, onMove: () => moves.push(driveMode.mode) });
}

const receive = (control) => driveMode.receive(control);
const lose = (why, reason = "") => driveMode.lose(why, reason);
const ask = () => driveMode.ask();
const loseAsk = () => [lose("lease_held"), ask()];
const refuse = () => receive({ driver: ann, waiting: null });
const kept = () => receive({ driver: null, reserved: me });
const stop = () => [lose("robot_stopped"), receive({ stopped })];
const askAgain = () => [askAnn(), driveMode.withdraw(), ask()];
const REFUSED = { why: "refused", by: "ann" };
const askAnn = () => [lose("lease_held"), receive({ driver: ann }), ask(), receive({ driver: ann, waiting: me })];

// What is so after some steps, by the drive mode's own members; `moves` are the connections it asked for, `why` is that of its note.
function check(expected) {
  for (const [name, value] of Object.entries({ moves: [], ...expected })) {
    const { why } = driveMode.note ?? { why: null };
    assert.deepEqual({ ...driveMode, moves, why, asking: driveMode.asking, free: driveMode.free }[name], value, name);
  }
}

// Of a page that drives.
const WHILE_DRIVING = {
  "who gives up the control watches": [() => driveMode.leave(), { moves: ["observe"], mode: "observe", armed: false, why: "left" }],
  "control that is kept for who asked is taken, not armed": [() => [loseAsk(), kept()], { moves: ["drive"], armed: false, why: "arrived" }],
  "a driver who leaves leaves the control to who asked": [() => [askAnn(), receive({ driver: null })], { moves: ["drive"], armed: false }],
  "but not where it is kept for somebody else": [() => [askAnn(), receive({ driver: null, reserved: ben })], { mode: "observe" }],
  "a question that is gone while the driver stays was refused": [() => [askAnn(), refuse()], { note: REFUSED, asked: null }],
  "a question that was refused brings no control": [() => [askAnn(), refuse(), kept()], { mode: "observe" }],
  "news from before the question is no refusal": [() => [loseAsk(), receive({ driver: ann })], { asked: "sent" }],
  "a question that was withdrawn brings no control": [() => [askAnn(), driveMode.withdraw(), kept()], { mode: "observe" }],
  "who withdraws and asks again is told of no refusal": [() => [askAgain(), refuse()], { note: null, asked: "sent" }],
  "who asked again is waited for": [() => [askAgain(), refuse(), receive({ driver: ann, waiting: me })], { asked: "waiting" }],
  "a stop ends the question": [() => [askAnn(), receive({ driver: null, stopped })], { asked: null, why: "stopped_meanwhile" }],
  "a question answered for another window of the same person ends here": [() => [askAnn(), receive({ driver: mine })], { asked: null }],
  "who drove when the robot was stopped may drive on by releasing it": [() => stop(), { wasStopped: true }],
  "who releases it so drives on by a new press": [
    () => [stop(), driveMode.released(true)],
    { moves: ["drive"], armed: true, pressed: false },
  ],
  "but not once somebody else released it": [() => [stop(), receive({ stopped: null }), receive({ stopped })], { wasStopped: false }],
  "only the driver's own page is asked": [() => receive({ driver: mine, waiting: ben }), { asking: ben }],
  "a page that no longer drives is not asked": [() => [receive({ driver: mine, waiting: ben }), lose("superseded")], { asking: null }],
  "a page that is told nothing any more knows nobody": [() => [askAnn(), driveMode.end()], { known: false, asking: null, asked: null }],
  "a page that is told nothing any more takes nothing": [() => [askAnn(), driveMode.end(), receive({ driver: null })], { mode: "observe" }],
  "a release ends no other note": [() => [lose("lease_held"), receive({ stopped }), receive({ driver: ann })], { why: "lease_held" }],
};

for (const [name, [act, expected]] of Object.entries(WHILE_DRIVING)) {
  test(name, () => {
    sitDown("drive", { armed: true });
    act();
    check(expected);
  });
}

const pressFree = () => [receive({ driver: null }), driveMode.press()];

// Of a page that watches.
const WHILE_WATCHING = {
  "for others a release leaves the control free": [() => [receive({ stopped }), driveMode.released(false)], { wasStopped: false }],
  "a press takes the control that nobody has, and says so": [
    () => [receive({ driver: null }), check({ free: true }), assert.ok(driveMode.press())],
    { moves: ["drive"], armed: true, why: "pressed", pressed: true },
  ],
  "a press has driven on once the connection stands": [() => [pressFree(), driveMode.settle()], { moves: ["drive"], pressed: false }],
  "a press before it is known who drives does nothing": [() => assert.ok(!driveMode.press() && driveMode.actions(true).length === 0), {}],
  "a press that lost the race has to be made anew": [
    () => [pressFree(), lose("lease_held")],
    { moves: ["drive"], pressed: false, armed: false },
  ],
  "who asked before a reload can ask again": [() => [receive({ driver: ann, waiting: me }), ask(), refuse()], { note: REFUSED }],
};

for (const [name, [act, expected]] of Object.entries(WHILE_WATCHING)) {
  test(name, () => {
    sitDown();
    act();
    check(expected);
  });
}

test("a page that is opened watches, whoever opens it, as does one whose person may no longer drive", () => {
  for (const [level, drove] of [["observe"], ["drive"], ["manage"], ["observe", { armed: true }]]) {
    sitDown(level, drove);
    receive({ driver: null });
    check({ mode: "observe", armed: false });
    assert.deepEqual(driveMode.actions(true), level === "observe" ? [] : ["drive"]);
  }
});

test("a page that is loaded anew while it drove drives on, armed if it was", () => {
  for (const armed of [true, false]) {
    sitDown("drive", { armed });
    check({ mode: "drive", armed });
    assert.deepEqual(driveMode.saved, { armed });
  }
  driveMode.leave();
  assert.equal(driveMode.saved, null);
});

for (const why of ["superseded", "robot_stopped", "lease_held", "lease_lost"]) {
  test(`after ${why} the page watches, not armed, and does not come back by itself`, () => {
    sitDown("drive", { armed: true });
    lose(why, "reason");
    for (const control of [{ driver: null }, { driver: null, reserved: me }]) {
      receive(control);
      check({ mode: "observe", armed: false });
    }
  });
}

test("who handed the control over reads that, and not that somebody else has it", () => {
  sitDown("drive", { armed: true });
  driveMode.handedTo = "ben";
  lose("lease_lost", "ben controls sim1 now");
  check({ note: { why: "handed_over", by: "ben" } });
  assert.match(notes.handed_over(driveMode.note), /^You handed control to ben\.$/);
  driveMode.drive();
  lose("lease_lost", "ann controls sim1 now");
  check({ moves: ["drive"], note: { why: "lease_lost", reason: "ann controls sim1 now" } });
});

for (const [who, control, why] of [
  ["somebody else drives", { driver: ann }, "busy_driver"],
  ["another window of the same person drives", { driver: mine }, "busy_window"],
  ["somebody is about to drive", { reserved: ben }, "busy_reserved"],
  ["the robot is stopped", { stopped }, "busy_stopped"],
]) {
  test(`a press while ${who} takes and asks nothing, and says why until that changes`, () => {
    sitDown();
    receive(control);
    assert.equal(driveMode.press(), false);
    check({ free: false, asked: null, why });
    receive(control);
    check({ why });
    receive({ driver: null });
    check({ note: null });
  });
}

test("that the robot was stopped is said until it is released", () => {
  sitDown("drive", { armed: true });
  for (const say of [() => lose("robot_stopped"), () => driveMode.setNote({ why: "stopped_meanwhile" })]) {
    say();
    receive({ driver: null, stopped });
    assert.notEqual(driveMode.note, null);
    receive({ driver: ann });
    check({ note: null });
  }
});

// What the buttons offer: the level, what has happened, and the actions on a page that is connected.
for (const [level, act, actions] of [
  ["drive", () => receive({ driver: null }), ["drive"]],
  ["drive", () => receive({ driver: mine }), ["drive"]],
  ["drive", () => receive({ driver: null, reserved: ben }), []],
  ["drive", () => receive({ driver: ann }), ["ask"]],
  ["drive", () => receive({ driver: ann, waiting: ben }), []],
  ["drive", () => receive({ driver: ann, waiting: me }), ["ask"]],
  ["drive", () => receive({ driver: null, stopped }), []],
  ["drive", () => [ask(), receive({ driver: ann, waiting: me })], ["withdraw"]],
  ["drive", () => [receive({ driver: ann, waiting: me }), ask()], ["withdraw"]],
  ["drive", () => [ask(), receive({ driver: null, reserved: me })], ["arm", "leave"]],
  ["drive", () => [ask(), receive({ driver: null, reserved: me }), driveMode.arm()], ["leave"]],
  ["manage", () => receive({ driver: ann }), ["ask", "take"]],
  ["manage", () => [receive({ driver: ann }), ask()], ["withdraw", "take"]],
]) {
  test(`at level ${level} after ${act} a page offers [${actions}], and without a connection nothing`, () => {
    sitDown(level);
    act();
    assert.deepEqual([driveMode.actions(true), driveMode.actions(false)], [actions, []]);
  });
}

test("a page that drives and waits for its robot can give the control up, and takes it no more when the robot is back", () => {
  sitDown("drive", { armed: true });
  assert.deepEqual([driveMode.actions(false), driveMode.actions(false, true)], [[], ["leave"]]);
  driveMode.leave();
  assert.deepEqual([driveMode.mode, driveMode.actions(false, true)], ["observe", []]);
});

let store, clock, arrival;

beforeEach(() => {
  store = new Map();
  clock = 1000;
  arrival = "reload";
});

const load = (robot = "sim1") =>
  new ReloadStore(robot, { store: new LocalStore(() => storageOf(store)), arrival: () => arrival, now: () => clock });

test("a page that drove when it was loaded anew may drive on, once, and one that did not leaves nothing", () => {
  load().save(null);
  assert.equal(load().restore(), null);
  load().save({ armed: true });
  assert.equal(load().restore().armed, true);
  assert.equal(load().restore(), null);
});

test("nothing is kept for another robot, for later, or for a page that is opened", () => {
  load().save({ armed: true });
  assert.equal(load("sim2").restore(), null);
  for (const later of [20_000, -20_000]) {
    load().save({ armed: true });
    clock += later;
    assert.equal(load().restore(), null);
  }
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
