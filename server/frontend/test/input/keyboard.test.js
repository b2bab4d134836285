import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { direction, FieldFocus, Keyboard } from "../../src/input/keyboard.js";
import { inside } from "../fakes.js";

const FORWARD = { forward: 1, left: 0, turn: 0 };
const LEFT = { forward: 0, left: 0, turn: 1 };

let told, timestamps, steps, stale, lit, teleop, keyboard;

const TEXT_FIELD = inside("input:not([type=range]):not([type=checkbox])");
const SLIDER = inside("input[type=range]");

const down = (code, more = {}) => press("down", code, more);
const up = (code, more = {}) => press("up", code, more);

// Gives whether the usual effect of the key was prevented.
function press(name, code, more) {
  const event = { code, target: inside(), timeStamp: 1000, prevented: false, ...more };
  event.preventDefault = () => (event.prevented = true);
  keyboard[name](event);
  return event.prevented;
}

function make(kind = "differential") {
  [told, timestamps, steps, stale, lit] = [[], [], [], [], []];
  teleop = {
    accepts: true,
    hold: (_, input, at) => told.push(input) && timestamps.push(at),
    release: () => told.push("released"),
    letGo: () => told.push("let go"),
  };
  const handlers = { onStep: (by) => steps.push(by), onStale: (any) => stale.push(any), onKeys: (codes) => lit.push(codes) };
  keyboard = new Keyboard({ teleop, kind, ...handlers });
}

beforeEach(() => make());

for (const [codes, expected] of [
  [["KeyW", "KeyA"], { forward: 1, left: 0, turn: 1 }],
  [["ArrowDown", "ArrowRight"], { forward: -1, left: 0, turn: -1 }],
  [["KeyW", "KeyS", "KeyD"], { forward: 0, left: 0, turn: -1 }],
  [["KeyW", "ArrowUp"], FORWARD],
  [["KeyW", "ArrowUp", "KeyS"], { forward: 0, left: 0, turn: 0 }],
]) {
  test(`${codes.join(" and ")} drive in their direction: opposite keys cancel, and two for one count once`, () => {
    assert.deepEqual(direction(codes), expected);
  });
}

const REPEAT = { repeat: true };
const TYPED = { target: TEXT_FIELD };
const CTRL = { ctrlKey: true };
const ARROW = "ArrowUp";

// What the keys report to the controls, by what is pressed and released.
for (const [name, act, expected] of [
  ["a held key counts once, whatever its repeats", () => [down("KeyW"), down("KeyW", REPEAT), up("KeyW")], [FORWARD, "released"]],
  ["after a halt its repeats drive no more", () => [down("KeyW"), keyboard.drop(), down("KeyW", REPEAT), up("KeyW")], [FORWARD]],
  ["keys typed into a field do nothing", () => [down("KeyW", TYPED), down("Space", TYPED)], []],
  ["letters drive from a checkbox", () => down("KeyW", { target: inside("input[type=checkbox]") }), [FORWARD]],
  ["a key let go in a field is let go", () => [down("KeyW"), up("KeyW", TYPED)], [FORWARD, "released"]],
  ["Q and E do nothing on a robot that goes no way sideways", () => [down("KeyQ"), down("KeyE")], []],
  ["and drive so on one that does", () => [make("holonomic"), down("KeyQ"), up("KeyQ")], [{ forward: 0, left: 1, turn: 0 }, "released"]],
  ["Ctrl with W, which closes the page, is no step", () => [down("ControlLeft", CTRL), down("KeyW", CTRL)], ["let go", "let go"]],
  ["Ctrl, which may swallow the keyup, lets go", () => [down("KeyW"), down("KeyD", CTRL)], [FORWARD, "let go"]],
  ["Meta does so, too", () => [down("KeyW"), down("KeyD", { metaKey: true })], [FORWARD, "let go"]],
  ["Alt does so, too", () => [down("KeyW"), down("KeyD", { altKey: true })], [FORWARD, "let go"]],
]) {
  test(name, () => {
    act();
    assert.deepEqual(told, expected);
  });
}

test("a press has its own timestamp, and the space bar is not this input's: it stops the robot", () => {
  assert.equal(down("Space"), false);
  down("KeyW", { timeStamp: 1234.5 });
  assert.deepEqual([told, timestamps], [[FORWARD], [1234.5]]);
});

test("a key that was held through a reload or a halt is reported, until it is let go or dropped", () => {
  down("KeyW", REPEAT);
  up("KeyW");
  assert.deepEqual([stale, told], [[true, false], []]);
  down("KeyW");
  down("KeyW", REPEAT);
  assert.deepEqual(stale, [true, false]);
  keyboard.drop();
  down("KeyW", REPEAT);
  assert.equal(stale.at(-1), true);
  keyboard.drop();
  assert.equal(stale.at(-1), false);
});

test("the repeats of an arrow key that drives do not push a slider that took the focus", () => {
  down(ARROW);
  assert.equal(down(ARROW, { target: SLIDER, repeat: true }), true);
  up(ARROW, { target: SLIDER });
  assert.deepEqual(told, [FORWARD, "released"]);
});

test("a key pressed while driving is not armed never counts, not by its repeats nor with another key", () => {
  teleop.accepts = false;
  down("KeyW");
  teleop.accepts = true;
  down("KeyW", REPEAT);
  assert.deepEqual(told, []);
  down("KeyA");
  up("KeyA");
  up("KeyW");
  assert.deepEqual(told, [LEFT, "released"]);
  down("KeyW");
  assert.deepEqual(told.at(-1), FORWARD);
});

test("a key that repeats into a window that just got the focus does not count", () => {
  const target = new EventTarget();
  keyboard.listen(target);
  const focus = new Event("focus");
  target.dispatchEvent(focus);
  down("KeyW", { timeStamp: focus.timeStamp + 40 });
  down("KeyW", { timeStamp: focus.timeStamp + 400, repeat: true });
  assert.deepEqual(told, []);
  down("KeyW", { timeStamp: focus.timeStamp + 400 });
  assert.deepEqual(told, [FORWARD]);
});

test("Shift asks for a step faster and X for a slower one, as long as they are held and counted", () => {
  down("ShiftLeft");
  down("KeyW", { shiftKey: true });
  down("KeyX", { shiftKey: true });
  assert.deepEqual(lit.at(-1), ["KeyW", "ShiftLeft", "KeyX"]);
  up("ShiftLeft", { shiftKey: false });
  up("KeyX", { shiftKey: false });
  assert.deepEqual(steps, [1, 0, -1, 0]);
  down("ShiftLeft");
  keyboard.drop();
  down("ShiftLeft", REPEAT);
  down("KeyX", { target: TEXT_FIELD });
  teleop.accepts = false;
  down("ShiftRight");
  assert.deepEqual([steps.slice(4), lit.at(-1)], [[1, 0], []]);
});

test("a Shift whose release nobody reported is none with the next key", () => {
  down("ShiftLeft", { shiftKey: true });
  down("ShiftRight", { shiftKey: true });
  up("ShiftRight", { shiftKey: false });
  assert.equal(steps.at(-1), 0);
});

let window, fields, kept;

function field(kind, more = {}) {
  const made = { closest: (selector) => (selector.split(", ").includes(kind) ? made : null), ...more };
  return Object.assign(made, { blurs: 0, blur: () => (made.blurs += 1) });
}

function fire(name, target, more = {}) {
  const event = Object.assign(new Event(name), more);
  Object.defineProperty(event, "target", { value: target });
  window.dispatchEvent(event);
}

const byTab = (target) => {
  fire("keydown", target, { code: "Tab" });
  fire("focusin", target);
};
const byPointer = (target) => {
  fire("pointerdown", target);
  fire("focusin", target);
};
const keeps = (code, target) => fields.keeps({ code, target });

let menu, slider, text;

beforeEach(() => {
  window = new EventTarget();
  kept = [];
  fields = new FieldFocus({ onChange: () => kept.push(fields.taken) });
  fields.listen(window);
  menu = field("select");
  slider = field("input[type=range]");
  text = field("textarea");
});

const label = () => field("label", { control: slider });
const arrow = (target) => keeps("ArrowUp", target);

// What the fields keep after some steps: arrow keys, letters, and what is said of it.
for (const [name, act, of, ...expected] of [
  ["a menu that Tab reached keeps the arrow keys", () => byTab(menu), () => menu, true, false, "menu"],
  ["so does a slider", () => byTab(slider), () => slider, true, false, "slider"],
  ["a menu that a pointer used keeps nothing", () => byPointer(menu), () => menu, false, false, ""],
  ["nor does a slider", () => byPointer(slider), () => slider, false, false, ""],
  ["nor one whose label was used", () => [fire("pointerdown", label()), fire("focusin", slider)], () => slider, false, false, ""],
  ["Tab gives them back", () => [byPointer(slider), fire("focusout", slider), byTab(slider)], () => slider, true, false, "slider"],
  ["a field for text that Tab reached keeps all keys", () => byTab(text), () => text, true, true, "text"],
  ["so does one that a pointer reached", () => byPointer(text), () => text, true, true, "text"],
  ["of one that was left nothing is said", () => [byTab(text), fire("focusout", text)], () => text, true, true, ""],
]) {
  test(`fields: ${name}`, () => {
    act();
    assert.deepEqual([arrow(of()), keeps("KeyW", of()), kept.at(-1)], expected);
  });
}

test("a pointer that lets go of a slider leaves it, and opens a menu without closing it", () => {
  for (const target of [slider, menu]) {
    byPointer(target);
    fire("pointerup", target);
  }
  assert.deepEqual([slider.blurs, menu.blurs], [1, 0]);
});

test("Esc gives the keys back, from fields alone", () => {
  const all = [text, menu, slider, field("main")];
  for (const target of all) fire("keydown", target, { code: "Escape" });
  assert.equal(all.map(({ blurs }) => blurs).join(), "1,1,1,0");
});
