import assert from "node:assert/strict";
import { test } from "node:test";

import { numberAt, numbersIn, preview } from "../../src/topics/fields.js";

const ODOMETRY = {
  header: { stamp: { sec: 12, nanosec: 5 }, frame_id: "odom" },
  twist: { twist: { linear: { x: 0.5 } }, covariance: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10] },
  moving: true,
};

test("numbers are found by their paths, of lists the first ones", () => {
  const found = numbersIn(ODOMETRY);
  assert.deepEqual(found.slice(0, 3), ["header.stamp.sec", "header.stamp.nanosec", "twist.twist.linear.x"]);
  assert.ok(found.includes("twist.covariance[7]"));
  assert.ok(!found.includes("twist.covariance[8]"));
  assert.equal(found.at(-1), "moving");
});

for (const [path, number] of [
  ["twist.twist.linear.x", 0.5],
  ["twist.covariance[3]", 4],
  ["moving", 1],
  ["pose.x", NaN],
  ["header.frame_id", NaN],
]) {
  test(`the path ${path} leads to ${number}`, () => assert.equal(numberAt(ODOMETRY, path), number));
}

test("a path that was found leads into a list", () => {
  const message = { a: [{ b: 7 }] };
  assert.equal(numberAt(message, numbersIn(message)[0]), 7);
});

test("a message with very many numbers offers a bounded choice", () => {
  const wide = Object.fromEntries(Array.from({ length: 1000 }, (_, i) => [`joint${i}`, i]));
  assert.equal(numbersIn(wide).length, 200);
});

const NUMBERS = { x: 0.123456789, sec: 1795583926, at: [1.23456e-7, 12345.678] };

for (const [what, message, text, options] of [
  ["names and values", { h: { id: "o" }, r: [1, 2], names: [], none: null }, "h:\n  id: o\nr: [1, 2]\nnames: []\nnone: null"],
  ["four digits of numbers, all of whole ones", NUMBERS, "x: 0.1235\nsec: 1795583926\nat: [1.235e-7, 12346]"],
  ["all digits", NUMBERS, "x: 0.123456789\nsec: 1795583926\nat: [1.23456e-7, 12345.678]", { exact: true }],
  ["the places of objects in a list", { s: [{ l: 0 }, { l: 1 }] }, "s:\n  [0]:\n    l: 0\n  [1]:\n    l: 1"],
]) {
  test(`a message is shown with ${what}`, () => assert.equal(preview(message, options), text));
}

test("long lists, texts and messages are cut, and say so", () => {
  assert.match(preview({ ranges: Array(400).fill(1) }), /^ranges: \[(1, ){15}1, … 384 more\]$/);
  assert.match(preview({ data: "x".repeat(500) }), /x… 340 more characters$/);
  assert.match(preview({ points: Array(9).fill({ x: 1 }) }), /… 5 more$/);
  const long = preview(Object.fromEntries(Array.from({ length: 1000 }, (_, i) => [`n${i}`, i])));
  assert.equal(long.split("\n").length, 201);
  assert.ok(long.endsWith("\n…"));
});

test("what is nested without end is cut as well", () => {
  let deep = { x: 1 };
  for (let i = 0; i < 100; i++) deep = { deep };
  assert.ok(preview(deep).split("\n").length < 20);
  assert.deepEqual(numbersIn(deep), []);
});
