import assert from "node:assert/strict";
import { test } from "node:test";

import { itemsToMove } from "../../src/fleet/list.js";

const moves = (present, wanted) => [...itemsToMove([...present], [...wanted])].join("");

test("what is in order stays", () => {
  assert.equal(moves("abcd", "abcd"), "");
  assert.equal(moves("", ""), "");
});

test("one that goes to the other end moves alone", () => {
  assert.equal(moves("abcd", "bcda"), "a");
  assert.equal(moves("abcd", "dabc"), "d");
});

test("what is new moves in, what is gone moves nobody", () => {
  assert.equal(moves("abd", "abcd"), "c");
  assert.equal(moves("abcd", "abd"), "");
});

test("of a list that is turned around, all but one move", () => {
  assert.equal(itemsToMove([..."abcd"], [..."dcba"]).size, 3);
});

test("what moves brings the list into order, wherever it was", () => {
  const wanted = Array.from({ length: 60 }, (_, i) => `r${i}`);
  const shuffled = [...wanted].sort((a, b) => ((a.length * 7 + a.charCodeAt(1) * 31) % 17) - ((b.length * 7 + b.charCodeAt(1) * 31) % 17));
  const moving = itemsToMove(shuffled, wanted);
  const staying = shuffled.filter((name) => !moving.has(name));
  assert.deepEqual(
    staying,
    wanted.filter((name) => !moving.has(name)),
  );
  assert.ok(moving.size < wanted.length);
});
