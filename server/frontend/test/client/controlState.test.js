import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { ControlState } from "../../src/client/session.js";

let heard, state;

beforeEach(() => {
  heard = [];
  state = new ControlState({ onControl: (control) => heard.push(control) });
});

test("the events count while the connection has told nothing", () => {
  state.fromFeed("a");
  state.fromLink("b");
  assert.deepEqual(heard, ["a", "b"]);
});

test("while the connection tells, older news of the events change nothing", () => {
  state.fromLink("stopped");
  state.fromFeed("not yet stopped");
  assert.deepEqual(heard, ["stopped"]);
});

test("what the events told last counts when the connection has ended", () => {
  state.fromLink("driven");
  state.fromFeed("stopped");
  state.linkEnded();
  assert.deepEqual(heard, ["driven", "stopped"]);
  state.fromFeed("released");
  assert.equal(heard.at(-1), "released");
});

test("the connection's own last word stands when the events told nothing after it", () => {
  state.fromLink("a");
  state.fromFeed("a, late");
  state.fromLink("b");
  state.linkEnded();
  assert.deepEqual(heard, ["a", "b"]);
});
