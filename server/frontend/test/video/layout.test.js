import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { Layout, MAP } from "../../src/video/layout.js";

const ALL = ["/a", "/b", "/c"];

let layout;

beforeEach(() => {
  layout = new Layout();
  layout.offer(ALL);
});

const choose = (id) => layout.choose(id);
const offer = (...ids) => layout.offer(ids);

// What is shown, the main one first, or in a grid in its place.
for (const [name, act, shown] of [
  ["one frame is shown until more are wanted", () => {}, ["/a"]],
  ["what is not a layout changes nothing", () => [layout.use("inset"), layout.use("nonsense")], ["/a", "/b"]],
  ["beside a map that is chosen the camera before goes on", () => [offer(...ALL, MAP), choose("/b"), choose(MAP)], [MAP, "/b"]],
  ["a camera that is chosen after it is alone again", () => [offer(...ALL, MAP), choose("/b"), choose(MAP), choose("/a")], ["/a"]],
  ["a map without any camera stands alone", () => offer(MAP), [MAP]],
  ["swapping makes the main one the inset", () => [layout.use("inset"), choose("/b")], ["/b", "/a"]],
  ["the next camera goes round", () => [layout.next(), layout.next(), layout.next()], ["/a"]],
  ["a number names one, and one too high none", () => [layout.nth(2), layout.nth(3)], ["/c"]],
  ["a grid has four places", () => [layout.use("grid"), offer(...ALL, "/d", "/e"), choose("/c")], ["/a", "/b", "/c", "/d"]],
  ["a fifth takes the last place of it", () => [layout.use("grid"), offer(...ALL, "/d", "/e"), choose("/e")], ["/a", "/b", "/c", "/e"]],
  ["while a chosen camera is away there is another", () => [choose("/c"), offer("/a", "/b")], ["/a"]],
  ["a chosen camera comes back into its place", () => [choose("/c"), offer("/a", "/b"), offer(...ALL)], ["/c"]],
  ["no source shows nothing", () => [offer(), layout.next()], []],
]) {
  test(name, () => {
    act();
    assert.deepEqual(layout.shown, shown);
  });
}

test("what has shown a frame stays the main one until another is chosen, whatever comes later", () => {
  layout = new Layout({ main: "/c" });
  const mains = [() => [offer("/b"), layout.keep("/b"), offer(...ALL)], () => layout.keep("/a"), () => choose("/c")].map((act) => {
    act();
    return layout.main;
  });
  assert.deepEqual(mains, ["/b", "/b", "/c"]);
});

test("what was chosen is remembered, and nonsense in the memory is left out", () => {
  layout.use("inset");
  choose("/c");
  layout.turn("/c");
  layout = new Layout(JSON.parse(JSON.stringify(layout.memory)));
  offer(...ALL);
  assert.deepEqual([layout.shown, layout.turned("/c")], [["/c", "/a"], 90]);
  layout = new Layout({ kind: 7, main: {}, turns: { "/a": 45 } });
  offer("/a");
  assert.deepEqual([layout.shown, layout.turned("/a")], [["/a"], 0]);
});
