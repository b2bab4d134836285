import assert from "node:assert/strict";
import { test } from "node:test";

import { answerWords, refusalWords, succeeded } from "../../src/control/robotButtons.js";

test("success is what rosbridge and the service both call so", () => {
  assert.equal(succeeded({ ok: true, values: {} }), true);
  assert.equal(succeeded({ ok: true, values: { success: true } }), true);
  assert.equal(succeeded({ ok: true, values: { success: false } }), false);
  assert.equal(succeeded({ ok: false, values: "no such service" }), false);
});

test("an answer is its message, its other values, or a text", () => {
  assert.equal(answerWords({ values: { success: true, message: "docked" } }), "docked");
  assert.equal(answerWords({ values: { success: true } }), "");
  assert.equal(answerWords({ values: { sum: 3 } }), '{"sum":3}');
  assert.equal(answerWords({ values: {} }), "");
  assert.equal(answerWords({ values: null }), "");
  assert.equal(answerWords({ values: "service /x does not exist" }), "service /x does not exist");
});

test("what a robot says is cut before it fills the page", () => {
  assert.equal(answerWords({ values: { message: "x".repeat(1000) } }).length, 301);
  assert.equal(refusalWords("x".repeat(1000)).length, 301);
  assert.equal(refusalWords(undefined), "");
});
