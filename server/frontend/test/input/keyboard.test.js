import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { direction, FieldFocus, Keyboard } from "../../src/input/keyboard.js";

let told, moments, teleop, keyboard;

// An element that stands inside exactly the given kinds of elements.
const element = (...kinds) => ({ closest: (selector) => kinds.some((kind) => selector.split(", ").includes(kind)) || null });
const BODY = element();
const TEXT_FIELD = element("input:not([type=range]):not([type=checkbox])");
const SLIDER = element("input[type=range]");

function key(code, more = {}) {
  const event = { code, target: BODY, timeStamp: 1000, prevented: false, ...more };
  event.preventDefault = () => (event.prevented = true);
  return event;
}

beforeEach(() => {
  told = [];
  moments = [];
  teleop = {
    accepts: true,
    hold: (_, input, at) => told.push(input) && moments.push(at),
    release: () => told.push("released"),
    letGo: () => told.push("let go"),
  };
  keyboard = new Keyboard({ teleop, kind: "differential" });
});

test("W drives forward, A turns left, and arrows do the same", () => {
  assert.deepEqual(direction(["KeyW", "KeyA"]), { forward: 1, left: 0, turn: 1 });
  assert.deepEqual(direction(["ArrowDown", "ArrowRight"]), { forward: -1, left: 0, turn: -1 });
});

test("opposite keys cancel, and two keys for one direction count once", () => {
  assert.deepEqual(direction(["KeyW", "KeyS", "KeyD"]), { forward: 0, left: 0, turn: -1 });
  assert.deepEqual(direction(["KeyW", "ArrowUp"]), { forward: 1, left: 0, turn: 0 });
  assert.deepEqual(direction(["KeyW", "ArrowUp", "KeyS"]), { forward: 0, left: 0, turn: 0 });
});

test("holding and letting go is told once each, whatever the key repeat", () => {
  keyboard.down(key("KeyW", { timeStamp: 1234.5 }));
  keyboard.down(key("KeyW", { repeat: true }));
  keyboard.up(key("KeyW"));
  assert.deepEqual([told, moments], [[{ forward: 1, left: 0, turn: 0 }, "released"], [1234.5]]);
});

test("a key that a halt dropped does not drive on by its repeats", () => {
  keyboard.down(key("KeyW"));
  keyboard.drop();
  keyboard.down(key("KeyW", { repeat: true }));
  keyboard.up(key("KeyW"));
  assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0 }]);
});

test("a key that was held through a reload or a halt is reported, until it is let go or dropped", () => {
  const stale = [];
  keyboard.onStale = (any) => stale.push(any);
  keyboard.down(key("KeyW", { repeat: true }));
  keyboard.up(key("KeyW"));
  assert.deepEqual([stale, told], [[true, false], []]);
  keyboard.down(key("KeyW"));
  keyboard.down(key("KeyW", { repeat: true }));
  assert.deepEqual(stale, [true, false]);
  keyboard.drop();
  keyboard.down(key("KeyW", { repeat: true }));
  assert.equal(stale.at(-1), true);
  keyboard.drop();
  assert.equal(stale.at(-1), false);
});

test("keys typed into a field do nothing, nor does the space bar, which stops the robot; a checkbox keeps none", () => {
  const space = key("Space");
  for (const event of [key("KeyW", { target: TEXT_FIELD }), key("Space", { target: TEXT_FIELD }), space]) keyboard.down(event);
  assert.deepEqual([told, space.prevented], [[], false]);
  keyboard.down(key("KeyW", { target: element("input[type=checkbox]") }));
  assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0 }]);
});

test("letters drive past a menu or slider that has the focus, which keeps its arrow keys", () => {
  for (const target of [element("select"), SLIDER]) {
    const arrow = key("ArrowUp", { target });
    keyboard.down(arrow);
    assert.equal(arrow.prevented, false);
    const letter = key("KeyW", { target });
    keyboard.down(letter);
    assert.equal(letter.prevented, true);
    keyboard.up(key("KeyW", { target }));
  }
  assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0 }, "released", { forward: 1, left: 0, turn: 0 }, "released"]);
});

test("a key pressed on the page and let go in a field is let go", () => {
  keyboard.down(key("KeyW"));
  keyboard.up(key("KeyW", { target: TEXT_FIELD }));
  assert.equal(told.at(-1), "released");
});

test("the repeats of an arrow key that drives do not push a slider that took the focus", () => {
  keyboard.down(key("ArrowUp"));
  const repeated = key("ArrowUp", { target: SLIDER, repeat: true });
  keyboard.down(repeated);
  assert.equal(repeated.prevented, true);
  keyboard.up(key("ArrowUp", { target: SLIDER }));
  assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0 }, "released"]);
});

for (const modifier of ["ctrlKey", "metaKey", "altKey"]) {
  test(`${modifier} lets go of everything, since what it opens may swallow the keyup`, () => {
    keyboard.down(key("KeyW"));
    keyboard.down(key("KeyD", { [modifier]: true }));
    assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0 }, "let go"]);
  });
}

test("a key pressed while driving is not armed never counts, not by its repeats nor with another key", () => {
  teleop.accepts = false;
  keyboard.down(key("KeyW"));
  teleop.accepts = true;
  keyboard.down(key("KeyW", { repeat: true }));
  assert.deepEqual(told, []);
  keyboard.down(key("KeyD"));
  keyboard.up(key("KeyD"));
  keyboard.up(key("KeyW"));
  assert.deepEqual(told, [{ forward: 0, left: 0, turn: -1 }, "released"]);
  keyboard.down(key("KeyW"));
  assert.deepEqual(told.at(-1), { forward: 1, left: 0, turn: 0 });
});

test("a key that repeats into a window that just got the focus does not count", () => {
  const target = new EventTarget();
  keyboard.listen(target);
  const focus = new Event("focus");
  target.dispatchEvent(focus);
  keyboard.down(key("KeyW", { timeStamp: focus.timeStamp + 40 }));
  keyboard.down(key("KeyW", { timeStamp: focus.timeStamp + 400, repeat: true }));
  assert.deepEqual(told, []);
  keyboard.down(key("KeyW", { timeStamp: focus.timeStamp + 400 }));
  assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0 }]);
});

test("Q and E go sideways, on a robot that can", () => {
  keyboard.down(key("KeyQ"));
  assert.deepEqual(told, []);
  keyboard = new Keyboard({ teleop, kind: "holonomic" });
  keyboard.down(key("KeyQ"));
  keyboard.down(key("KeyE"));
  keyboard.up(key("KeyQ"));
  assert.deepEqual(
    told.map(({ left }) => left),
    [1, 0, -1],
  );
});

test("Shift asks for a step faster and X for a slower one, as long as they are held and counted", () => {
  const steps = [];
  const lit = [];
  keyboard = new Keyboard({ teleop, kind: "differential", onStep: (by) => steps.push(by), onKeys: (codes) => lit.push(codes) });
  keyboard.down(key("ShiftLeft"));
  keyboard.down(key("KeyW", { shiftKey: true }));
  keyboard.down(key("KeyX", { shiftKey: true }));
  assert.deepEqual(lit.at(-1), ["KeyW", "ShiftLeft", "KeyX"]);
  keyboard.up(key("ShiftLeft", { shiftKey: false }));
  keyboard.up(key("KeyX", { shiftKey: false }));
  assert.deepEqual(steps, [1, 0, -1, 0]);
  keyboard.down(key("ShiftLeft"));
  keyboard.drop();
  keyboard.down(key("ShiftLeft", { repeat: true }));
  keyboard.down(key("KeyX", { target: TEXT_FIELD }));
  teleop.accepts = false;
  keyboard.down(key("ShiftRight"));
  assert.deepEqual(steps.slice(4), [1, 0]);
  assert.deepEqual(lit.at(-1), []);
});

test("a Shift whose release nobody reported is none with the next key", () => {
  const steps = [];
  keyboard = new Keyboard({ teleop, kind: "differential", onStep: (by) => steps.push(by) });
  keyboard.down(key("ShiftLeft", { shiftKey: true }));
  keyboard.down(key("ShiftRight", { shiftKey: true }));
  keyboard.up(key("ShiftRight", { shiftKey: false }));
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

test("a menu or slider that Tab reached keeps the arrow keys, says so, and lets letters drive", () => {
  for (const [field, name] of [
    [menu, "menu"],
    [slider, "slider"],
  ]) {
    byTab(field);
    assert.deepEqual([keeps("ArrowUp", field), keeps("KeyW", field)], [true, false]);
    assert.equal(kept.at(-1), name);
  }
});

test("one that a pointer used keeps nothing, even if it keeps the focus", () => {
  for (const field of [menu, slider]) {
    byPointer(field);
    assert.deepEqual([keeps("ArrowUp", field), keeps("KeyW", field)], [false, false]);
    assert.equal(kept.at(-1), "");
  }
});

test("to point at its label is to point at it", () => {
  const label = field("label", { control: slider });
  fire("pointerdown", label);
  fire("focusin", slider);
  assert.equal(keeps("ArrowUp", slider), false);
});

test("one that Tab reaches after a pointer used it keeps the arrow keys again", () => {
  byPointer(slider);
  fire("focusout", slider);
  byTab(slider);
  assert.equal(keeps("ArrowUp", slider), true);
});

test("a pointer that lets go of a slider leaves it, and opens a menu without closing it", () => {
  byPointer(slider);
  fire("pointerup", slider);
  byPointer(menu);
  fire("pointerup", menu);
  assert.deepEqual([slider.blurs, menu.blurs], [1, 0]);
});

test("a field for text keeps all keys, however it was reached", () => {
  for (const reach of [byTab, byPointer]) {
    reach(text);
    assert.deepEqual([keeps("ArrowUp", text), keeps("KeyW", text)], [true, true]);
    assert.equal(kept.at(-1), "text");
  }
  fire("focusout", text);
  assert.equal(kept.at(-1), "");
});

test("Esc gives the keys back, from fields alone", () => {
  const page = field("main");
  for (const field of [text, menu, slider, page]) fire("keydown", field, { code: "Escape" });
  assert.deepEqual(
    [text, menu, slider, page].map(({ blurs }) => blurs),
    [1, 1, 1, 0],
  );
});
