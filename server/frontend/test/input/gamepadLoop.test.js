import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { GamepadLoop } from "../../src/input/gamepad.js";

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

const last = () => told.at(-1)[0];

test("without a gamepad nothing is looked at, and no frame is asked for", () => {
  assert.deepEqual(frames, []);
  assert.deepEqual(told, []);
});

test("a gamepad is found, and then looked at once in each frame, with the moment of the look", () => {
  connect(1, "stick");
  draw();
  assert.deepEqual(told, [["found", { id: "stick", mapping: "standard", axes: 2, buttons: 3 }]]);
  draw();
  assert.deepEqual(told.at(-1), ["seen", { axes: [0, -1], buttons: [true, true, false] }, at]);
  assert.equal(frames.length, 1);
});

const GONE = {
  "that the browser no longer has": () => (pads[1] = null),
  "that is no longer connected": () => (pads[1].connected = false),
  "in whose place there is another": () => (pads[1] = pad(1, "other")),
};

for (const [what, go] of Object.entries(GONE)) {
  test(`a gamepad ${what} is lost with the next look`, () => {
    connect(1, "stick");
    draw();
    draw();
    go();
    draw();
    assert.ok(told.some(([what]) => what === "lost"));
    assert.ok(["lost", "found"].includes(last()));
  });
}

test("a gamepad that goes is lost at once, also on a page that draws no frame", () => {
  connect(1, "stick");
  draw();
  pads[1] = null;
  window.dispatchEvent(new Event("gamepaddisconnected"));
  assert.equal(last(), "lost");
  draw();
  assert.deepEqual(frames, []);
});

test("a second gamepad changes nothing until it is chosen", () => {
  connect(0, "first");
  draw();
  connect(1, "second");
  draw();
  assert.deepEqual(
    loop.all.map(({ id, chosen }) => [id, chosen]),
    [
      ["first", true],
      ["second", false],
    ],
  );
  loop.choose(1);
  assert.deepEqual(
    told.slice(-2).map(([what, device]) => device?.id ?? what),
    ["lost", "second"],
  );
});

// The loop with a rank of each device by its id.
function ranked(ranks, mayChange = () => true) {
  loop.rank = ({ id }) => ranks[id];
  loop.mayChange = mayChange;
}

const found = () => told.filter(([what]) => what === "found").map(([, { id }]) => id);

test("what can drive is found beside what cannot, whichever came first", () => {
  ranked({ ghost: 0, stick: 2 });
  pads[0] = pad(0, "ghost");
  connect(1, "stick");
  draw();
  draw();
  assert.deepEqual(found(), ["stick"]);
});

test("what can drive takes over from what cannot, but not from the hand", () => {
  let held = true;
  ranked({ ghost: 0, stick: 2 }, () => !held);
  connect(0, "ghost");
  draw();
  connect(1, "stick");
  draw();
  assert.deepEqual(found(), ["ghost"]);
  held = false;
  window.dispatchEvent(new Event("gamepadconnected"));
  draw();
  assert.deepEqual(found(), ["ghost", "stick"]);
  assert.equal(last(), "seen");
});

test("what a person chose stays, whatever else comes", () => {
  ranked({ ghost: 0, stick: 2 });
  connect(1, "stick");
  connect(0, "ghost");
  draw();
  loop.choose(0);
  window.dispatchEvent(new Event("gamepadconnected"));
  draw();
  assert.deepEqual(found(), ["stick", "ghost"]);
});

test("however many come and go, one look is made in a frame", () => {
  connect(0, "first");
  connect(1, "second");
  loop.choose(1);
  assert.equal(frames.length, 1);
});
