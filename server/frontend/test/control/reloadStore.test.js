import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { ReloadStore } from "../../src/control/driveMode.js";
import { LocalStore } from "../../src/dom/page.js";

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
const load = (robot = "sim1") => new ReloadStore(robot, { store: new LocalStore(() => storage), arrival: () => arrival, now: () => clock });

test("a page that drove when it was loaded anew is told so, once", () => {
  load().save({ armed: true });
  assert.equal(load().restore().armed, true);
  assert.equal(load().restore(), null);
});

test("a page that did not drive leaves nothing", () => {
  load().save(null);
  assert.equal(load().restore(), null);
});

test("nothing is kept for another robot, for later, or for a page that is opened", () => {
  load().save({ armed: true });
  assert.equal(load("sim2").restore(), null);
  clock += 20_000;
  assert.equal(load().restore(), null);
  load().save({ armed: true });
  arrival = "navigate";
  assert.equal(load().restore(), null);
  arrival = "reload";
  assert.equal(load().restore(), null);
});

test("Drive on another page is granted to the page that it opens, once and soon", () => {
  arrival = "navigate";
  load().save({ armed: true, asked: true });
  assert.equal(load("sim2").restore(), null);
  assert.equal(load().restore().armed, true);
  assert.equal(load().restore(), null);
  load().save({ armed: true, asked: true });
  clock += 20_000;
  assert.equal(load().restore(), null);
});
