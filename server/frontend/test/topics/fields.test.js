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

test("a path that was found leads to its number", () => {
  assert.equal(numberAt(ODOMETRY, "twist.twist.linear.x"), 0.5);
  assert.equal(numberAt(ODOMETRY, "twist.covariance[3]"), 4);
  assert.equal(numberAt(ODOMETRY, "moving"), 1);
  assert.equal(numberAt({ a: [{ b: 7 }] }, numbersIn({ a: [{ b: 7 }] })[0]), 7);
  assert.ok(Number.isNaN(numberAt(ODOMETRY, "pose.x")));
  assert.ok(Number.isNaN(numberAt(ODOMETRY, "header.frame_id")));
});

test("a message with very many numbers offers a bounded choice", () => {
  const wide = Object.fromEntries(Array.from({ length: 1000 }, (_, i) => [`joint${i}`, i]));
  assert.equal(numbersIn(wide).length, 200);
});

test("a message is shown as names and values", () => {
  assert.equal(
    preview({ header: { frame_id: "odom" }, ranges: [1, 2], names: [], none: null }),
    "header:\n  frame_id: odom\nranges: [1, 2]\nnames: []\nnone: null",
  );
});

test("numbers have four digits, or all of them; whole ones have all", () => {
  const message = { x: 0.123456789, sec: 1795583926, at: [1.23456e-7, 12345.678] };
  assert.equal(preview(message), "x: 0.1235\nsec: 1795583926\nat: [1.235e-7, 12346]");
  assert.equal(preview(message, { exact: true }), "x: 0.123456789\nsec: 1795583926\nat: [1.23456e-7, 12345.678]");
});

test("objects in a list have their place", () => {
  assert.equal(preview({ status: [{ level: 0 }, { level: 1 }] }), "status:\n  [0]:\n    level: 0\n  [1]:\n    level: 1");
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
  assert.deepEqual(numbersIn(deep), []);
});
