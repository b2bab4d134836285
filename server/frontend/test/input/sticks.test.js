import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Joystick, stick, Sticks } from "../../src/input/sticks.js";
import { FakeElement } from "../fakes.js";

let told, timestamps, armed, element, joystick;

beforeEach(() => {
  [told, timestamps, armed] = [[], [], true];
  const captured = new Set();
  element = Object.assign(new FakeElement(), {
    setPointerCapture: (id) => captured.add(id),
    hasPointerCapture: (id) => captured.has(id),
    releasePointerCapture: (id) => captured.delete(id),
    getBoundingClientRect: () => ({ left: 0, top: 0, width: 240, height: 240 }),
  });
  joystick = new Joystick({
    element,
    knob: { offsetWidth: 40, style: {} },
    accepts: () => armed,
    onHold: (input, at) => told.push(input) && timestamps.push(at),
    onRelease: () => told.push("released"),
  });
});

function send(name, more) {
  const event = Object.defineProperty(new Event(name), "timeStamp", { value: 77.5 });
  element.dispatchEvent(Object.assign(event, more));
}

function pointer(name, pointerId, clientX, clientY, buttons = 1) {
  send(`pointer${name}`, { pointerId, clientX, clientY, button: 0, buttons });
}

const down = (y = 20, id = 1) => pointer("down", id, 120, y);
const move = (y = 20, id = 1, buttons = 1) => pointer("move", id, 120, y, buttons);
const up = (id = 1) => pointer("up", id, 120, 20, 0);
const UP = { up: 1, left: 0 };
const CENTRE = { up: 0, left: 0 };

test("up and left count as positive, full at the rim and no more beyond it", () => {
  assert.deepEqual([stick(0, -100, 100), stick(-100, 0, 100).left, stick(0, 300, 100).up], [UP, 1, -1]);
  const corner = stick(300, -300, 100);
  assert.ok(Math.abs(Math.hypot(corner.up, corner.left) - 1) < 1e-9);
});

test("a resting thumb near the centre moves nothing, and strength grows from there without a step", () => {
  assert.deepEqual(stick(0, -8, 100), { up: 0, left: 0 });
  assert.ok(stick(0, -9, 100).up < 0.02);
});

// What the stick reports, by what the pointers do.
for (const [name, act, ...expected] of [
  ["letting go is reported once", () => [down(120), move(), up(), send("lostpointercapture", { pointerId: 1 })], CENTRE, UP, "released"],
  ["a second finger changes nothing", () => [down(), down(120, 2), move(220, 2), up(2)], UP],
  ["a pointer that is cancelled lets go", () => [down(), pointer("cancel", 1, 120, 20)], UP, "released"],
  ["so does one that is captured no more", () => [down(), send("lostpointercapture", { pointerId: 1 })], UP, "released"],
  ["after a drop the same drag drives no longer", () => [down(), joystick.drop(), move()], UP],
  ["until it is pressed anew", () => [down(), joystick.drop(), move(), down()], UP, UP],
  ["a press while driving is not armed never counts", () => [(armed = false), down(), (armed = true), move(21), up()]],
  ["the next one does", () => [(armed = false), down(), (armed = true), move(21), up(), down()], UP],
  ["a pointer that moves without being pressed has been let go elsewhere", () => [down(), move(20, 1, 0), move()], UP, "released"],
]) {
  test(name, () => {
    act();
    assert.deepEqual(told, expected);
  });
}

test("a finger that is gone before its press is seen keeps the stick from no other", () => {
  const capture = element.setPointerCapture;
  element.setPointerCapture = () => assert.fail("NotFoundError");
  assert.throws(() => joystick.down({ pointerId: 1, button: 0, preventDefault() {} }));
  element.setPointerCapture = capture;
  down(20, 2);
  assert.deepEqual(told, [UP]);
});

test("a stick that the page moves while it is pressed does not steer, and a hold has its event's timestamp", () => {
  down();
  element.getBoundingClientRect = () => ({ left: 0, top: 60, width: 240, height: 240 });
  move();
  assert.deepEqual(told, [UP, UP]);
  assert.deepEqual(timestamps, [77.5, 77.5]);
  up();
  down(180);
  assert.deepEqual(told.at(-1), { up: 0, left: 0 });
});

test("of both sticks, a drag that was dropped holds nothing, nor does a press that does not count", () => {
  const root = new FakeElement();
  const { getBoundingClientRect } = element;
  const pad = {
    getBoundingClientRect,
    setPointerCapture() {},
    hasPointerCapture: () => false,
    querySelector: () => ({ offsetWidth: 40, style: {} }),
  };
  const makePart = () => Object.assign(new FakeElement(), pad, { parentElement: root });
  root.querySelector = (selector) => root.parts.get(selector) ?? root.parts.set(selector, makePart()).get(selector);
  const teleop = { accepts: true, letGo() {}, hold: () => told.push("held"), release: () => told.push("released") };
  const sticks = new Sticks(root, { kind: "holonomic", teleop, choices: { all: {}, keep() {} } });
  for (const stick of [sticks.main, sticks.second]) {
    element = stick.element;
    down();
    sticks.drop();
    move();
    assert.deepEqual(told, ["held"]);
    down();
    up();
    teleop.accepts = false;
    down();
    assert.deepEqual(told.splice(0), ["held", "held", "released"]);
    teleop.accepts = true;
  }
});
