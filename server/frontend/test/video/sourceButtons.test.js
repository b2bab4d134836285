import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { SourceButtons } from "../../src/video/sourceButtons.js";
import { FakeElement } from "../fakes.js";

// A group, or a button with its parts.
class FakeButton extends FakeElement {
  get value() {
    return this.attributes.get("value");
  }
  insertBefore(child, next) {
    super.insertBefore(child, next);
    inserted.push(child);
  }
  querySelector(selector) {
    return this.children.find(({ attributes }) => selector === `[data-part="${attributes.get("data-part")}"]`);
  }
}

let group, inserted, buttons;

beforeEach(() => {
  inserted = [];
  globalThis.document = { createElement: () => new FakeButton() };
  group = new FakeButton();
  buttons = new SourceButtons(group, { onChoose() {} });
});

const sources = (...names) => names.map((name) => ({ id: `/${name}`, name }));
const readButton = (button) => [button.dataset.testid, ...button.children.map(({ textContent }) => textContent)].join(" ");

test("a button that a finger is on stays as it is when sources come and go", () => {
  buttons.offer(sources("Front", "Map"));
  const [front, map] = group.children;
  inserted = [];
  buttons.offer(sources("Front", "Rear", "Map"));
  const rear = group.children[1];
  assert.deepEqual(group.children, [front, rear, map]);
  assert.ok(!inserted.includes(front) && !inserted.includes(map));
  assert.equal(readButton(map), "view-3 3 Map");
  inserted = [];
  buttons.offer(sources("Rear", "Map"));
  assert.deepEqual(group.children, [rear, map]);
  assert.deepEqual(inserted, []);
  assert.equal(readButton(rear), "view-1 1 Rear");
});
