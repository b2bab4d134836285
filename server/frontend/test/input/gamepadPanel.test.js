import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { LocalStore, byTestId, part } from "../../src/dom/page.js";
import { GamepadPanel } from "../../src/input/gamepadPanel.js";
import { FakeElement, storageOf } from "../fakes.js";

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
  const panel = new GamepadPanel(root, { kind: "differential", teleop: { letGo() {} }, limits, onStop, store });
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

test("the stop button of each known gamepad stops, not only of the chosen one", () => {
  let stops = 0;
  const panel = openPanel(() => (stops += 1));
  const pad = (index) => ({ ...DEVICE, index, connected: true, axes: [0, 0, 0, 0], buttons: Array(17).fill({}) });
  const second = pad(1);
  panel.loop.pads = () => [pad(0), second];
  panel.loop.choose(0);
  second.buttons = second.buttons.with(1, { pressed: true });
  panel.loop.poll();
  panel.loop.poll();
  assert.equal(stops, 1);
});
