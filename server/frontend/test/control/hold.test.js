import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Hold } from "../../src/control/stopBar.js";

let button, clock, done, hold, states;

function send(name, more = {}) {
  const event = Object.assign(new Event(name, { cancelable: true }), more);
  button.dispatchEvent(event);
  return event;
}

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setTimeout", "Date"] });
  button = new EventTarget();
  done = 0;
  states = [];
  clock = null; // goes with the timers
  const now = () => clock ?? Date.now();
  hold = new Hold({ onDone: () => (done += 1), onState: (state) => states.push(state), now });
  hold.listen(button);
});

test("it acts after one second of holding, once", () => {
  send("pointerdown", { button: 0 });
  mock.timers.tick(999);
  assert.equal(done, 0);
  mock.timers.tick(1);
  assert.equal(done, 1);
  mock.timers.tick(5000);
  send("pointerup");
  assert.equal(done, 1);
  assert.deepEqual(states, ["held", "idle"]);
});

for (const end of ["pointerup", "pointerleave", "pointercancel", "blur"]) {
  test(`${end} before that is no release`, () => {
    send("pointerdown", { button: 0 });
    mock.timers.tick(900);
    send(end);
    mock.timers.tick(5000);
    assert.equal(done, 0);
  });
}

test("a page that was frozen meanwhile could not see the release, so it has to be pressed anew", () => {
  send("pointerdown", { button: 0 });
  clock = Date.now() + 60_000;
  mock.timers.tick(1000);
  assert.equal(done, 0);
  assert.deepEqual(states, ["held", "idle"]);
});

for (const code of ["Enter", "Space"]) {
  test(`${code} can hold it, and its repeats do not begin anew`, () => {
    assert.equal(send("keydown", { code }).defaultPrevented, true);
    for (let i = 0; i < 9; i++) {
      mock.timers.tick(100);
      send("keydown", { code, repeat: true });
    }
    assert.equal(done, 0);
    mock.timers.tick(100);
    assert.equal(done, 1);
    send("keydown", { code, repeat: true });
    mock.timers.tick(5000);
    assert.equal(done, 1);
  });

  test(`${code} that is let go early does nothing`, () => {
    send("keydown", { code });
    mock.timers.tick(500);
    send("keyup", { code });
    mock.timers.tick(5000);
    assert.equal(done, 0);
  });
}

test("other keys and buttons do nothing", () => {
  send("keydown", { code: "KeyW" });
  send("pointerdown", { button: 2 });
  mock.timers.tick(5000);
  assert.equal(done, 0);
});

test("a click of a mouse or finger does nothing, one of assistive technology has to come twice", () => {
  send("click", { detail: 1, pointerType: "mouse" });
  assert.deepEqual(states, []);
  send("click", { detail: 0, pointerType: "" });
  assert.deepEqual(states, ["once"]);
  assert.equal(done, 0);
  send("click", { detail: 0, pointerType: "" });
  assert.equal(done, 1);
  send("click", { detail: 0 });
  mock.timers.tick(5000); // too far apart
  send("click", { detail: 0 });
  assert.equal(done, 1);
});

test("what is cancelled has to be pressed anew", () => {
  hold.cancel();
  assert.deepEqual(states, []);
  send("keydown", { code: "Enter" });
  mock.timers.tick(900);
  hold.cancel();
  send("keydown", { code: "Enter", repeat: true });
  mock.timers.tick(5000);
  assert.equal(done, 0);
  send("click", { detail: 0 });
  hold.cancel();
  send("click", { detail: 0 });
  assert.equal(done, 0);
  assert.deepEqual(states, ["held", "idle", "once", "idle", "once"]);
});
