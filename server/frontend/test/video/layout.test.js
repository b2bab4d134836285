import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Layout, MAP } from "../../src/video/layout.js";

let layout;

beforeEach(() => {
  layout = new Layout();
  layout.offer(["/a", "/b", "/c"]);
});

test("one picture is shown until more are wanted", () => {
  assert.deepEqual(layout.shown, ["/a"]);
  layout.use("inset");
  assert.deepEqual(layout.shown, ["/a", "/b"]);
  layout.use("nonsense");
  assert.equal(layout.kind, "inset");
});

test("beside a map that is chosen the camera before goes on, and alone again when it is chosen", () => {
  layout.offer(["/a", "/b", MAP]);
  layout.choose("/b");
  assert.deepEqual([layout.arranged, layout.shown], ["one", ["/b"]]);
  layout.choose(MAP);
  assert.deepEqual([layout.arranged, layout.shown], ["inset", [MAP, "/b"]]);
  layout.choose("/a");
  assert.deepEqual([layout.arranged, layout.shown], ["one", ["/a"]]);
});

test("a map without any camera stands alone", () => {
  layout.offer([MAP]);
  assert.deepEqual(layout.shown, [MAP]);
});

test("swapping makes the main one the inset", () => {
  layout.use("inset");
  layout.choose("/b");
  assert.deepEqual(layout.shown, ["/b", "/a"]);
  layout.choose("/b");
  assert.deepEqual(layout.shown, ["/b", "/a"]);
});

test("the next camera goes round, and a number names one", () => {
  layout.next();
  assert.equal(layout.main, "/b");
  layout.next();
  layout.next();
  assert.equal(layout.main, "/a");
  layout.nth(2);
  assert.equal(layout.main, "/c");
  layout.nth(3);
  assert.equal(layout.main, "/c");
});

test("a grid has four places, and whichever is main keeps its own", () => {
  layout.use("grid");
  layout.offer(["/a", "/b", "/c", "/d", "/e"]);
  layout.choose("/c");
  assert.deepEqual(layout.shown, ["/a", "/b", "/c", "/d"]);
  layout.choose("/e");
  assert.deepEqual(layout.shown, ["/a", "/b", "/c", "/e"]);
});

test("a camera that is wanted comes back into its place", () => {
  layout.choose("/c");
  layout.offer(["/a", "/b"]);
  assert.equal(layout.main, "/a");
  layout.offer(["/a", "/b", "/c"]);
  assert.equal(layout.main, "/c");
});

test("what has shown a frame stays the main one until another is chosen, whatever comes later", () => {
  const later = new Layout({ main: "/c" });
  later.offer(["/b"]);
  later.keep("/b");
  later.offer(["/a", "/b", "/c"]);
  assert.equal(later.main, "/b");
  later.keep("/a");
  assert.equal(later.main, "/b");
  later.choose("/c");
  assert.equal(later.main, "/c");
});

test("no source shows nothing", () => {
  layout.offer([]);
  layout.next();
  assert.deepEqual(layout.shown, []);
});

test("a camera turns by quarters on from how it is mounted", () => {
  assert.equal(layout.turned("/a", 270), 270);
  layout.turn("/a");
  assert.equal(layout.turned("/a", 270), 0);
  assert.equal(layout.turned("/b"), 0);
});

test("what was chosen is remembered, and nonsense in the memory is left out", () => {
  layout.use("inset");
  layout.choose("/c");
  layout.turn("/c");
  const later = new Layout(JSON.parse(JSON.stringify(layout.memory)));
  later.offer(["/a", "/b", "/c"]);
  assert.deepEqual([later.shown, later.turned("/c")], [["/c", "/a"], 90]);
  const fresh = new Layout({ kind: 7, main: {}, turns: { "/a": 45 } });
  fresh.offer(["/a"]);
  assert.deepEqual([fresh.shown, fresh.turned("/a")], [["/a"], 0]);
});
