import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Keyboard, direction } from "../src/keyboard.js";

let told, keyboard;

// An element that stands inside exactly the given kinds of elements.
const element = (...kinds) => ({
  closest: (selector) => kinds.some((kind) => selector.split(", ").includes(kind)) || null,
});
const BODY = element();
const TEXT_FIELD = element("input:not([type=range])");
const SLIDER = element("input[type=range]");

function key(code, more = {}) {
  const event = { code, target: BODY, prevented: false, ...more };
  event.preventDefault = () => (event.prevented = true);
  return event;
}

beforeEach(() => {
  told = [];
  keyboard = new Keyboard({
    onHold: (input) => told.push(input),
    onRelease: () => told.push("released"),
    onHalt: () => told.push("halt"),
  });
});

test("W drives forward, A turns left, and arrows do the same", () => {
  assert.deepEqual(direction(["KeyW", "KeyA"]), { forward: 1, turn: 1 });
  assert.deepEqual(direction(["ArrowDown", "ArrowRight"]), { forward: -1, turn: -1 });
});

test("opposite keys cancel, and two keys for one direction count once", () => {
  assert.deepEqual(direction(["KeyW", "KeyS", "KeyD"]), { forward: 0, turn: -1 });
  assert.deepEqual(direction(["KeyW", "ArrowUp"]), { forward: 1, turn: 0 });
  assert.deepEqual(direction(["KeyW", "ArrowUp", "KeyS"]), { forward: 0, turn: 0 });
});

test("holding and letting go is told once each, whatever the key repeat", () => {
  keyboard.down(key("KeyW"));
  keyboard.down(key("KeyW", { repeat: true }));
  keyboard.up(key("KeyW"));
  assert.deepEqual(told, [{ forward: 1, turn: 0 }, "released"]);
});

test("a key that a halt dropped does not drive on by its repeats", () => {
  keyboard.down(key("KeyW"));
  keyboard.drop();
  keyboard.down(key("KeyW", { repeat: true }));
  keyboard.up(key("KeyW"));
  assert.deepEqual(told, [{ forward: 1, turn: 0 }]);
});

test("keys typed into a field do nothing, not even the space bar", () => {
  keyboard.down(key("KeyW", { target: TEXT_FIELD }));
  keyboard.down(key("Space", { target: TEXT_FIELD }));
  assert.deepEqual(told, []);
});

test("a key pressed on the page and let go in a field is let go", () => {
  keyboard.down(key("KeyW"));
  keyboard.up(key("KeyW", { target: TEXT_FIELD }));
  assert.equal(told.at(-1), "released");
});

test("arrow keys on a slider move the slider, letters still drive", () => {
  const arrow = key("ArrowUp", { target: SLIDER });
  keyboard.down(arrow);
  assert.equal(arrow.prevented, false);
  assert.deepEqual(told, []);
  keyboard.down(key("KeyW", { target: SLIDER }));
  assert.deepEqual(told, [{ forward: 1, turn: 0 }]);
});

test("the space bar halts, without scrolling the page", () => {
  const space = key("Space");
  keyboard.down(space);
  keyboard.down(key("Space", { repeat: true }));
  assert.deepEqual(told, ["halt"]);
  assert.equal(space.prevented, true);
});

test("the space bar on a button halts and still presses the button", () => {
  const space = key("Space", { target: element("button") });
  keyboard.down(space);
  assert.deepEqual(told, ["halt"]);
  assert.equal(space.prevented, false);
});

test("a browser shortcut lets go of everything, since it may swallow the keyup", () => {
  keyboard.down(key("KeyW"));
  keyboard.down(key("KeyD", { metaKey: true }));
  assert.equal(told.at(-1), "released");
  assert.equal(keyboard.pressed.size, 0);
});
