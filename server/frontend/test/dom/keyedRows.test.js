import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { KeyedRows } from "../../src/dom/keyedRows.js";
import { FakeElement } from "../fakes.js";

for (const [name, before, after, moves] of [
  ["what stays is not moved, so that focus and choices stay with it", "abc", "bc", 0],
  ["what is new is put in its place", "bc", "ubcd", 2],
  ["what goes to the end moves alone", "abcd", "bcda", 1],
  ["what goes to the front moves alone", "abcd", "dabc", 1],
  ["a list that is turned around is in order", "abcd", "dcba", 3],
]) {
  test(`rows: ${name}`, () => {
    const container = new FakeElement();
    const rows = new KeyedRows({ container, keyOf: String, make: () => new FakeElement(), fill: (row, item) => (row.textContent = item) });
    rows.show([...before]);
    const elements = new Map(rows.elements);
    mock.method(container, "insertBefore");
    rows.show([...after]);
    assert.equal(container.children.map(({ textContent }) => textContent).join(""), after);
    assert.equal(container.insertBefore.mock.callCount(), moves);
    for (const [item, row] of rows.elements) assert.ok(!elements.has(item) || elements.get(item) === row);
  });
}
