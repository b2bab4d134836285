import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { SourceButtons } from "../../src/video/sourceButtons.js";
import { FakeElement } from "../control/fakes.js";

// A group, or a button with its parts.
class FakeButton extends FakeElement {
  get value() {
    return this.attributes.get("value");
  }
  addEventListener(name, act) {
    this[name] = act;
  }
  insertBefore(child, next) {
    super.insertBefore(child, next);
    inserted.push(child);
  }
  scrollIntoView() {
    scrolled.push(this.value);
  }
  querySelector(selector) {
    return this.children.find(({ attributes }) => selector === `[data-part="${attributes.get("data-part")}"]`);
  }
}

let group, inserted, chosen, scrolled, buttons;

beforeEach(() => {
  inserted = [];
  chosen = [];
  scrolled = [];
  globalThis.document = { createElement: () => new FakeButton() };
  group = new FakeButton();
  buttons = new SourceButtons(group, { onChoose: (id) => chosen.push(id) });
});

const sources = (...names) => names.map((name) => ({ id: `/${name}`, name }));
const readButton = (button) => [button.dataset.testid, ...button.children.map(({ textContent }) => textContent)].join(" ");

test("each source has a button with its name, and the number of its key where it has one", () => {
  buttons.offer(sources("Front", "Rear", "Left", "Right", "Top"));
  assert.deepEqual(group.children.map(readButton), ["view-1 1 Front", "view-2 2 Rear", "view-3 3 Left", "view-4 4 Right", "view-5  Top"]);
  const keys = group.children.map(({ attributes }) => attributes.get("aria-keyshortcuts"));
  assert.deepEqual(keys, ["1", "2", "3", "4", undefined]);
});

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

test("a source that moves past the fourth place loses its number, and one with another name shows it", () => {
  buttons.offer(sources("A", "B", "C", "D"));
  buttons.offer([{ id: "/A", name: "Arm" }, ...sources("New", "B", "C", "D")]);
  assert.deepEqual(group.children.map(readButton), ["view-1 1 Arm", "view-2 2 New", "view-3 3 B", "view-4 4 C", "view-5  D"]);
  assert.equal(group.children[4].attributes.get("aria-keyshortcuts"), undefined);
});

test("a finger beside the one on the stick, which makes no click, chooses a source as well", () => {
  buttons.offer(sources("Front", "Rear"));
  const target = { closest: () => group.children[1] };
  group.pointerup({ isPrimary: true, pointerType: "touch", target });
  assert.deepEqual(chosen, []); // its click comes
  group.pointerup({ isPrimary: false, pointerType: "touch", target });
  assert.deepEqual(chosen, ["/Rear"]);
});

test("the main one is pressed, and comes into view when it becomes it, not while it is scrolled past", () => {
  buttons.offer(sources("Front", "Rear"));
  const pressed = () => group.children.map((button) => button.getAttribute("aria-pressed"));
  buttons.show("/Rear");
  assert.deepEqual(pressed(), ["false", "true"]);
  buttons.show("/Rear");
  assert.deepEqual(scrolled, ["/Rear"]);
  buttons.show("/Front");
  assert.deepEqual(pressed(), ["true", "false"]);
  buttons.show(null);
  assert.deepEqual(pressed(), ["false", "false"]);
});
