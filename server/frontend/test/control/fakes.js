// As much of an element as the panels need; each of its parts is made when it is asked for.
export class FakeElement extends EventTarget {
  hidden = true;
  dataset = {};
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
  replaceChildren() {}
  contains() {
    return false;
  }
}
