import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Gamepad, MAX_POLL_GAP_MS, usualProfile } from "../../src/input/gamepad.js";

const PROFILE = usualProfile({ mapping: "standard", axes: 4, buttons: 17 }, "differential");
const { enable, turbo, stop } = PROFILE;
const FRAME_MS = 16;

let told, states, armed, at, gamepad;

beforeEach(() => {
  told = [];
  states = [];
  armed = true;
  at = 1000;
  gamepad = new Gamepad({
    accepts: () => armed,
    onHold: (input, timestamp) => told.push({ ...input, timestamp }),
    onRelease: () => told.push("released"),
    onStop: () => told.push("stop"),
    onState: (state) => states.push(state),
  });
  gamepad.use(PROFILE);
  see();
});

// One look, a frame after the last, at a stick that is pushed forward and these buttons.
function see(...pressed) {
  seeAfter(FRAME_MS, ...pressed);
}

function seeAfter(ms, ...pressed) {
  at += ms;
  const buttons = [...Array(17).keys()].map((i) => pressed.includes(i));
  gamepad.see({ axes: [0, -1, 0, 0], buttons }, at);
}

const holds = () => told.filter((one) => one.timestamp);

test("a stick alone moves nothing; with the enable button it drives, until that is released", () => {
  see();
  assert.deepEqual(told, []);
  see(enable);
  assert.deepEqual(told, [{ forward: 1, left: 0, turn: 0, turbo: false, timestamp: at }]);
  see();
  see();
  assert.equal(told.at(-1), "released");
  assert.equal(told.length, 2);
});

test("each look has its own moment", () => {
  see(enable);
  see(enable);
  assert.deepEqual(
    holds().map(({ timestamp }) => timestamp),
    [at - FRAME_MS, at],
  );
});

test("turbo counts while enable is held, and alone it moves nothing", () => {
  see(turbo);
  assert.deepEqual(told, []);
  see(enable, turbo);
  assert.equal(told.at(-1).turbo, true);
  assert.equal(states.at(-1), "turbo");
  see(enable);
  assert.equal(told.at(-1).turbo, false);
});

test("an enable button that is stuck when the gamepad comes moves nothing until released and pressed", () => {
  gamepad.forget();
  see(enable);
  see(enable);
  assert.deepEqual(told, []);
  assert.equal(states.at(-1), "stuck");
  see();
  see(enable);
  assert.equal(holds().length, 1);
});

test("after a drop the button that is still held does not drive on", () => {
  see(enable);
  gamepad.drop();
  see(enable);
  assert.equal(holds().length, 1);
  see();
  see(enable);
  assert.equal(holds().length, 2);
});

test("a press that did not count does not count later either", () => {
  armed = false;
  see(enable);
  armed = true;
  see(enable);
  assert.deepEqual(told, []);
  see();
  see(enable);
  assert.equal(holds().length, 1);
});

test("where driving ends without a word, the next look releases", () => {
  see(enable);
  armed = false;
  see(enable);
  assert.equal(told.at(-1), "released");
  assert.equal(states.at(-1), "off");
});

test("a late look renews nothing: enable may have been released meanwhile", () => {
  see(enable);
  seeAfter(MAX_POLL_GAP_MS + 1, enable);
  assert.equal(told.at(-1), "released");
  see(enable);
  assert.equal(holds().length, 1);
});

test("a look that is not so late drives on", () => {
  see(enable);
  seeAfter(MAX_POLL_GAP_MS, enable);
  assert.equal(holds().length, 2);
});

test("a gamepad that is gone is released once, and comes back as one that nobody has seen released", () => {
  see(enable);
  gamepad.forget();
  gamepad.forget();
  assert.deepEqual(told.slice(1), ["released"]);
  see(enable);
  assert.equal(holds().length, 1);
});

test("other settings let go of what is held", () => {
  see(enable);
  gamepad.use({ ...PROFILE, deadZone: 0.3 });
  assert.equal(told.at(-1), "released");
  see(enable);
  assert.equal(holds().length, 1);
});

test("the stop button stops once for each press, and whether driving counts or not", () => {
  armed = false;
  see(stop);
  see(stop);
  assert.deepEqual(told, ["stop"]);
  see();
  see(stop);
  assert.deepEqual(told, ["stop", "stop"]);
});

test("a stop button that is pressed at the first look stops: pressing it may be what made the gamepad seen", () => {
  gamepad.forget();
  see(stop);
  assert.deepEqual(told, ["stop"]);
});

test("a stop lets go before the same look could drive on", () => {
  gamepad.onStop = () => {
    told.push("stop");
    gamepad.drop(); // as teleop.js does when it halts
  };
  see(enable);
  see(enable, stop);
  see(enable);
  assert.deepEqual(told.slice(1), ["stop"]);
});

test("a gamepad without a profile neither drives nor stops", () => {
  gamepad.use(null);
  see(enable, stop);
  assert.deepEqual(told, []);
  assert.equal(states.at(-1), "unknown");
});
