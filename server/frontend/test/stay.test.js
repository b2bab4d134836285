import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Kept } from "../src/kept.js";
import { Stay } from "../src/stay.js";

let store, clock, arrival;

beforeEach(() => {
  store = new Map();
  clock = 1000;
  arrival = "reload";
});

const storage = {
  getItem: (name) => store.get(name) ?? null,
  setItem: (name, text) => store.set(name, text),
  removeItem: (name) => store.delete(name),
};
const load = (robot = "sim1") =>
  new Stay(robot, { kept: new Kept(() => storage), arrival: () => arrival, now: () => clock });

test("a page that drove when it was loaded anew is told so, once", () => {
  load().keep({ armed: true });
  assert.equal(load().take().armed, true);
  assert.equal(load().take(), null);
});

test("a page that did not drive leaves nothing", () => {
  load().keep(null);
  assert.equal(load().take(), null);
});

test("nothing is kept for another robot, for later, or for a page that is opened", () => {
  load().keep({ armed: true });
  assert.equal(load("sim2").take(), null);
  clock += 20_000;
  assert.equal(load().take(), null);
  load().keep({ armed: true });
  arrival = "navigate";
  assert.equal(load().take(), null);
  arrival = "reload";
  assert.equal(load().take(), null);
});
