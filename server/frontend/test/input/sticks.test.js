import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Joystick, stick } from "../../src/input/sticks.js";

let told, armed, element, joystick;

beforeEach(() => {
  told = [];
  armed = true;
  const captured = new Set();
  element = {
    dataset: {},
    handlers: {},
    addEventListener(name, handler) {
      this.handlers[name] = handler;
    },
    setPointerCapture: (id) => captured.add(id),
    hasPointerCapture: (id) => captured.has(id),
    releasePointerCapture: (id) => captured.delete(id),
    getBoundingClientRect: () => ({ left: 0, top: 0, width: 240, height: 240 }),
  };
  joystick = new Joystick({
    element,
    knob: { offsetWidth: 40, style: {} },
    accepts: () => armed,
    onHold: (input) => told.push(input),
    onRelease: () => told.push("released"),
  });
});

function pointer(name, pointerId, clientX, clientY, buttons = 1) {
  element.handlers[name]({ pointerId, clientX, clientY, button: 0, buttons, preventDefault() {} });
}

test("up and left count as positive, full at the rim and no more beyond it", () => {
  assert.deepEqual(stick(0, -100, 100), { up: 1, left: 0 });
  assert.equal(stick(-100, 0, 100).left, 1);
  assert.equal(stick(0, 300, 100).up, -1);
  const corner = stick(300, -300, 100);
  assert.ok(Math.abs(Math.hypot(corner.up, corner.left) - 1) < 1e-9);
});

test("a resting thumb near the centre moves nothing, and strength grows from there without a step", () => {
  assert.deepEqual(stick(0, -8, 100), { up: 0, left: 0 });
  assert.ok(stick(0, -9, 100).up < 0.02);
});

test("dragging is told, and letting go is told once", () => {
  pointer("pointerdown", 1, 120, 120);
  pointer("pointermove", 1, 120, 20);
  pointer("pointerup", 1, 120, 20);
  pointer("lostpointercapture", 1, 120, 20);
  assert.deepEqual(told, [{ up: 0, left: 0 }, { up: 1, left: 0 }, "released"]);
});

test("a second finger changes nothing", () => {
  pointer("pointerdown", 1, 120, 20);
  pointer("pointerdown", 2, 220, 120);
  pointer("pointermove", 2, 20, 120);
  pointer("pointerup", 2, 20, 120);
  assert.equal(told.length, 1);
  pointer("pointercancel", 1, 120, 20);
  assert.equal(told.at(-1), "released");
});

test("after a drop the same drag drives no longer until it is pressed anew", () => {
  pointer("pointerdown", 1, 120, 20);
  joystick.drop();
  pointer("pointermove", 1, 120, 20);
  assert.equal(told.length, 1);
  pointer("pointerdown", 1, 120, 20);
  assert.equal(told.length, 2);
});

test("a press while driving is not armed never counts, however it moves after arming", () => {
  armed = false;
  pointer("pointerdown", 1, 120, 20);
  armed = true;
  pointer("pointermove", 1, 120, 21);
  pointer("pointerup", 1, 120, 21);
  assert.deepEqual(told, []);
  pointer("pointerdown", 1, 120, 20);
  assert.deepEqual(told, [{ up: 1, left: 0 }]);
});

test("a pointer that moves without being pressed has been let go elsewhere", () => {
  pointer("pointerdown", 1, 120, 20);
  pointer("pointermove", 1, 120, 20, 0);
  assert.equal(told.at(-1), "released");
  pointer("pointermove", 1, 120, 20, 1);
  assert.equal(told.at(-1), "released");
});

test("a stick that the page moves while it is pressed does not steer", () => {
  pointer("pointerdown", 1, 120, 20);
  const pressed = told.at(-1);
  element.getBoundingClientRect = () => ({ left: 0, top: 60, width: 240, height: 240 });
  pointer("pointermove", 1, 120, 20);
  assert.deepEqual(told.at(-1), pressed);
  pointer("pointerup", 1, 120, 20, 0);
  pointer("pointerdown", 1, 120, 180);
  assert.deepEqual(told.at(-1), { up: 0, left: 0 });
});

test("a hold has the moment of its event", () => {
  const moments = [];
  joystick.onHold = (_, at) => moments.push(at);
  const event = { pointerId: 1, clientX: 120, clientY: 20, button: 0, buttons: 1, timeStamp: 77.5 };
  element.handlers.pointerdown({ ...event, preventDefault() {} });
  assert.deepEqual(moments, [77.5]);
});

test("a throttle goes up and down only, a rudder to the sides only", () => {
  joystick.ways = "upright";
  pointer("pointerdown", 1, 20, 20);
  joystick.ways = "level";
  pointer("pointermove", 1, 20, 20);
  assert.deepEqual(told, [
    { up: 1, left: 0 },
    { up: 0, left: 1 },
  ]);
});
