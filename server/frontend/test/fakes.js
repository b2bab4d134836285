// Test doubles of a page, and what tests of the scripts wait with.

// Lets all go on that waits for an answer which has come; no mocked timer moves.
export async function settle(turns = 5) {
  for (let i = 0; i < turns; i++) await new Promise((resolve) => setImmediate(resolve));
}

// An element that stands inside exactly the given kind of element.
export const inside = (kind, more = {}) => ({ closest: (selector) => selector.split(", ").includes(kind) || null, ...more });

// As much of an element as the pages need; each of its parts is made when it is asked for.
export class FakeElement extends EventTarget {
  hidden = true;
  dataset = {};
  style = {};
  textContent = "";
  parts = new Map();
  querySelector(selector) {
    if (!this.parts.has(selector)) this.parts.set(selector, new FakeElement());
    return this.parts.get(selector);
  }
  querySelectorAll() {
    return [];
  }
  attributes = new Map();
  focus() {}
  getAttribute(name) {
    return this.attributes.get(name) ?? null;
  }
  setAttribute(name, value) {
    this.attributes.set(name, value);
  }
  removeAttribute(name) {
    this.attributes.delete(name);
  }
  parent = null;
  children = [];
  get firstElementChild() {
    return this.children[0] ?? null;
  }
  get nextElementSibling() {
    return this.parent.children[this.parent.children.indexOf(this) + 1] ?? null;
  }
  append(...children) {
    for (const child of children) this.insertBefore(child, null);
  }
  insertBefore(child, next) {
    if (child instanceof FakeElement) {
      child.remove();
      child.parent = this;
    }
    this.children.splice(next ? this.children.indexOf(next) : this.children.length, 0, child);
  }
  remove() {
    this.parent?.children.splice(this.parent.children.indexOf(this), 1);
    this.parent = null;
  }
  replaceChildren(...children) {
    for (const child of [...this.children]) child.remove();
    this.append(...children);
  }
  contains() {
    return false;
  }
}

// The browser's storage, in memory.
export const storageOf = (values = new Map()) => ({
  getItem: (name) => values.get(name) ?? null,
  setItem: (name, text) => values.set(name, text),
  removeItem: (name) => values.delete(name),
});
