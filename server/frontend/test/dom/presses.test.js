import assert from "node:assert/strict";
import { test } from "node:test";

import { Presses } from "../../src/dom/presses.js";

// As much of the document as presses see: what an element is, and which control it is part of.
const element = (control, selectors = []) => {
  const made = { closest: (selector) => (selectors.some((one) => selector.includes(one)) ? (control ?? made) : null) };
  return made;
};
const button = () => element(undefined, ["button"]);

function page() {
  const listeners = {};
  new Presses().watch({ addEventListener: (name, act) => (listeners[name] = act) });
  const fire = (name, more) => {
    const event = { detail: 1, isTrusted: true, ignored: false, ...more };
    event.preventDefault = event.stopImmediatePropagation = () => (event.ignored = true);
    listeners[name](event);
    return !event.ignored;
  };
  return { down: (target) => fire("pointerdown", { target }), click: (target, more) => fire("click", { target, ...more }), fire };
}

test("a press counts on the control on which it began, also from a part of it", () => {
  const { down, click } = page();
  const drive = button();
  down(element(drive, ["button"]));
  assert.ok(click(drive));
});

test("a control that appears under the finger takes nothing", () => {
  const { down, click } = page();
  const [release, leave] = [button(), button()];
  down(release);
  assert.ok(!click(leave));
  down(element(null));
  assert.ok(!click(leave));
  down(leave);
  assert.ok(click(leave));
});

test("what is no control, and clicks of keys, scripts and assistive technology pass", () => {
  const { down, click } = page();
  down(button());
  assert.ok(click(element(null)));
  assert.ok(click(button(), { detail: 0 }));
  assert.ok(click(button(), { isTrusted: false }));
});

test("a second finger elsewhere leaves the first one's press as it is", () => {
  const { fire, click } = page();
  const [drive, other] = [button(), button()];
  fire("pointerdown", { target: drive, pointerId: 1, isPrimary: true });
  fire("pointerdown", { target: other, pointerId: 2, isPrimary: false });
  assert.ok(click(drive, { pointerId: 1 }));
  assert.ok(!click(drive, { pointerId: 2 }));
});

test("a label's press counts on its field", () => {
  const { down, click } = page();
  const field = element(undefined, ["input"]);
  const label = Object.assign(element(undefined, ["label"]), { control: field });
  down(label);
  assert.ok(click(field));
});

test("Stop acts whatever the press began on", () => {
  const { down, click } = page();
  down(button());
  assert.ok(click(element(undefined, ["button", ".stop"])));
});

test("a key that is held presses nothing that gets the focus meanwhile", () => {
  const { fire } = page();
  const enter = { code: "Enter", target: button() };
  assert.ok(fire("keydown", { ...enter, repeat: false }));
  assert.ok(!fire("keydown", { ...enter, repeat: true }));
  assert.ok(fire("keydown", { code: "KeyW", repeat: true, target: button() }));
});
