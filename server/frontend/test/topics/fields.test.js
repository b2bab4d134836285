import assert from "node:assert/strict";
import { test } from "node:test";

import { numberAt, numbersIn, preview } from "../../src/topics/fields.js";

const ODOMETRY = {
  header: { stamp: { sec: 12, nanosec: 5 }, frame_id: "odom" },
  twist: { twist: { linear: { x: 0.5 } }, covariance: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10] },
  moving: true,
};

for (const [path, number] of [
  ["twist.twist.linear.x", 0.5],
  ["twist.covariance[3]", 4],
  ["moving", 1],
  ["pose.x", NaN],
  ["header.frame_id", NaN],
]) {
  test(`the path ${path} leads to ${number}`, () => assert.equal(numberAt(ODOMETRY, path), number));
}

test("a message with very many numbers offers a bounded choice, and says so", () => {
  const wide = (count) => Object.fromEntries(Array.from({ length: count }, (_, i) => [`joint${i}`, i]));
  const numbers = [wide(200), wide(201), ODOMETRY, { ranges: [1, 2] }].map(numbersIn);
  assert.deepEqual(
    numbers.map(({ paths, isCut }) => [paths.length, isCut]),
    [
      [200, false],
      [200, true],
      [12, true],
      [2, false],
    ],
  );
});

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
  assert.deepEqual(numbersIn(deep), { paths: [], isCut: true });
});
