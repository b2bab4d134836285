import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { ControlNews } from "../src/news.js";

let heard, news;

beforeEach(() => {
  heard = [];
  news = new ControlNews({ onControl: (control) => heard.push(control) });
});

test("the events count while the connection has told nothing", () => {
  news.fromFeed("a");
  news.fromLink("b");
  assert.deepEqual(heard, ["a", "b"]);
});

test("while the connection tells, older news of the events change nothing", () => {
  news.fromLink("stopped");
  news.fromFeed("not yet stopped");
  assert.deepEqual(heard, ["stopped"]);
});

test("what the events told last counts when the connection has ended", () => {
  news.fromLink("driven");
  news.fromFeed("stopped");
  news.linkEnded();
  assert.deepEqual(heard, ["driven", "stopped"]);
  news.fromFeed("released");
  assert.equal(heard.at(-1), "released");
});

test("the connection's own last word stands when the events told nothing after it", () => {
  news.fromLink("a");
  news.fromFeed("a, late");
  news.fromLink("b");
  news.linkEnded();
  assert.deepEqual(heard, ["a", "b"]);
});
