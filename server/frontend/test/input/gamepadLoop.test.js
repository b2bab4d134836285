import assert from "node:assert/strict";
import { beforeEach, describe, test } from "node:test";

import { LocalStore, byTestId, part } from "../../src/dom/page.js";
import { GamepadLoop } from "../../src/input/gamepad.js";
import { GamepadPanel } from "../../src/input/gamepadPanel.js";
import { FakeElement, storageOf } from "../fakes.js";

let pads, frames, told, at, window, loop;

const pad = (index, id) => ({
  index,
  id,
  connected: true,
  mapping: "standard",
  axes: [0, -1],
  buttons: [
    { pressed: true, value: 1 },
    { pressed: false, value: 0.7 },
    { pressed: false, value: 0 },
  ],
});

beforeEach(() => {
  pads = [null, null];
  frames = [];
  told = [];
  at = 100;
  window = new EventTarget();
  loop = new GamepadLoop({
    onFound: (device) => told.push(["found", device]),
    onSeen: (sample, timestamp) => told.push(["seen", sample, timestamp]),
    onOther() {},
    onLost: () => told.push(["lost"]),
    onAll: (all) => (loop.all = all),
    pads: () => pads,
    frame: (act) => frames.push(act),
    now: () => at,
  });
  loop.listen(window);
});

// The browser draws its next frame.
function draw() {
  at += 16;
  frames.splice(0).forEach((act) => act());
}

function connect(index, id) {
  pads[index] = pad(index, id);
  window.dispatchEvent(new Event("gamepadconnected"));
}

const changed = () => window.dispatchEvent(new Event("gamepadconnected"));

const bothFound = () => [ranked(), connect(1, "stick"), connect(0, "ghost"), draw()];

// What was reported, a device by its id.
const report = () => told.map(([what, device]) => (what === "found" ? device.id : what)).join(" ");

// The loop with a rank of each device by its id.
const ranked = (mayChange = true) => Object.assign(loop, { rank: ({ id }) => ({ ghost: 0, stick: 2 })[id], mayChange: () => mayChange });

test("a gamepad is found, and then looked at once in each frame, with the timestamp of the look", () => {
  assert.deepEqual([frames, told], [[], []]); // without one no frame is asked for
  connect(1, "stick");
  draw();
  assert.deepEqual(told, [["found", { id: "stick", mapping: "standard", axes: 2, buttons: 3 }]]);
  draw();
  assert.deepEqual(told.at(-1), ["seen", { axes: [0, -1], buttons: [true, true, false] }, at]);
  assert.equal(frames.length, 1);
});

for (const [name, act, expected] of [
  ["one that the browser no longer has is lost", () => [connect(1, "stick"), draw(), draw(), (pads[1] = null), draw()], "stick seen lost"],
  ["one not connected, too", () => [connect(1, "stick"), draw(), draw(), (pads[1].connected = false), draw()], "stick seen lost"],
  ["another in its place is found", () => [connect(1, "a"), draw(), draw(), (pads[1] = pad(1, "b")), draw()], "a seen lost b"],
  ["the same with other axes", () => [connect(1, "a"), draw(), (pads[1] = { ...pads[1], axes: [0] }), changed(), draw()], "a lost a"],
  ["the one that can drive is found", () => [ranked(), (pads[0] = pad(0, "ghost")), connect(1, "stick"), draw(), draw()], "stick seen"],
  ["it takes over", () => [ranked(), connect(0, "ghost"), draw(), connect(1, "stick"), draw()], "ghost lost stick seen"],
  ["but not from the hand", () => [ranked(false), connect(0, "ghost"), draw(), connect(1, "stick"), draw()], "ghost seen"],
  ["a chosen one stays", () => [bothFound(), loop.choose(0), changed(), draw()], "stick lost ghost seen"],
]) {
  test(name, () => {
    act();
    assert.equal(report(), expected);
  });
}

test("a gamepad that goes is lost at once, also on a page that draws no frame", () => {
  connect(1, "stick");
  draw();
  pads[1] = null;
  window.dispatchEvent(new Event("gamepaddisconnected"));
  assert.equal(report(), "stick lost");
  draw();
  assert.deepEqual(frames, []);
});

describe("on the page", () => {
  const DEVICE = { id: "pad", mapping: "standard", axes: 4, buttons: 17 };

  let kept, root, limits;

  beforeEach(() => {
    Object.assign(globalThis, {
      document: { hasFocus: () => true },
      window: new EventTarget(),
      Option: FakeElement,
      requestAnimationFrame() {},
    });
    kept = new Map();
  });

  // A page that is opened, and the gamepad on it.
  function openPanel(onStop = () => {}) {
    root = new FakeElement();
    limits = { share: 1 };
    const store = new LocalStore(() => storageOf(kept));
    const panel = new GamepadPanel(root, { kind: "differential", teleop: { letGo() {}, held: new Map() }, limits, onStop, store });
    panel.found(DEVICE);
    return panel;
  }

  const control = (name) => part(byTestId(root, "gamepad"), name);
  const turbo = () => control("pad-turbo");

  test("the limit of turbo that a person set holds when the page is opened again", () => {
    openPanel();
    turbo().value = 40;
    turbo().dispatchEvent(new Event("input"));
    assert.equal(limits.share, 0.4);
    const panel = openPanel();
    assert.deepEqual([limits.share, turbo().value], [0.4, 40]);
    panel.change({ deadZone: 0.2 });
    assert.equal(limits.share, 0.4);
    panel.forget();
    assert.deepEqual([limits.share, turbo().value], [1, 100]);
  });

  test("a device that can drive comes first, and of those the one that a person chose at an earlier visit", () => {
    const panel = openPanel();
    const ghost = { id: "Virtual RGB Keyboard", mapping: "", axes: 6, buttons: 12 };
    const other = { ...DEVICE, id: "other" };
    assert.ok(panel.rank(DEVICE) > panel.rank(ghost));
    assert.equal(panel.rank(DEVICE), panel.rank(other));
    panel.loop.choose = () => panel.found(other);
    const choice = Object.assign(control("pad-choice"), { value: "1", blur() {} });
    choice.dispatchEvent(new Event("change"));
    const later = openPanel();
    assert.ok(later.rank(other) > later.rank(DEVICE));
    assert.ok(later.rank(DEVICE) > later.rank(ghost));
  });

  const IDLE = Array(17).fill({});
  const withPressed = (button) => IDLE.with(button, { pressed: true });
  const pad = (index) => ({ ...DEVICE, index, connected: true, axes: [0, 0, 0, 0], buttons: IDLE });

  for (const [name, pressed, byHand, expected] of /** @type {[string, number[], boolean, number][]} */ ([
    ["of two gamepads that can drive, the one whose enable button is pressed takes over", [1], false, 1],
    ["not from one that a person chose", [1], true, 0],
    ["not from one that is held, as where a driver shows one device twice", [0, 1], false, 0],
  ])) {
    test(name, () => {
      const panel = openPanel();
      Object.assign(panel.teleop, { armed: true, hold() {}, release() {} });
      const pads = [pad(0), pad(1)];
      panel.loop.pads = () => pads;
      panel.loop.choose(0);
      panel.loop.byHand = byHand;
      panel.loop.poll();
      for (const index of pressed) pads[index].buttons = withPressed(4);
      panel.loop.poll();
      assert.equal(panel.loop.chosen?.index, expected);
    });
  }

  test("the stop button of each known gamepad stops, not only of the chosen one", () => {
    let stops = 0;
    const panel = openPanel(() => (stops += 1));
    const second = pad(1);
    panel.loop.pads = () => [pad(0), second];
    panel.loop.choose(0);
    second.buttons = withPressed(1);
    panel.loop.poll();
    panel.loop.poll();
    assert.equal(stops, 1);
  });
});
