import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { FieldFocus } from "../../src/input/keyboard.js";

let window, fields, told;

function element(kind, more = {}) {
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
  told = [];
  fields = new FieldFocus({ onChange: () => told.push(fields.taken) });
  fields.listen(window);
  menu = element("select");
  slider = element("input[type=range]");
  text = element("textarea");
});

test("a menu or slider that Tab reached keeps the arrow keys, says so, and lets letters drive", () => {
  for (const [field, name] of [
    [menu, "menu"],
    [slider, "slider"],
  ]) {
    byTab(field);
    assert.deepEqual([keeps("ArrowUp", field), keeps("KeyW", field)], [true, false]);
    assert.equal(told.at(-1), name);
  }
});

test("one that a pointer used keeps nothing, even if it keeps the focus", () => {
  for (const field of [menu, slider]) {
    byPointer(field);
    assert.deepEqual([keeps("ArrowUp", field), keeps("KeyW", field)], [false, false]);
    assert.equal(told.at(-1), "");
  }
});

test("to point at its label is to point at it", () => {
  const label = element("label", { control: slider });
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
    assert.equal(told.at(-1), "text");
  }
  fire("focusout", text);
  assert.equal(told.at(-1), "");
});

test("Esc gives the keys back, from fields alone", () => {
  const page = element("main");
  for (const field of [text, menu, slider, page]) fire("keydown", field, { code: "Escape" });
  assert.deepEqual(
    [text, menu, slider, page].map(({ blurs }) => blurs),
    [1, 1, 1, 0],
  );
});
