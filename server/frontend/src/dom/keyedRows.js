// Keeps one element for each item of a list: what stays is only filled in, so that focus, choices and presses keep their place.
export class KeyedRows {
  // `make(item)` gives an element, `fill(element, item, place)` writes into it; `keyOf(item)` is the item's own.
  /** @param {{container: HTMLElement, keyOf: (item: any) => string, make: (item: any) => any, fill: Function}} options */
  constructor({ container, keyOf, make, fill }) {
    this.container = container;
    this.keyOf = keyOf;
    this.make = make;
    this.fill = fill;
    this.elements = new Map();
  }

  show(items) {
    const keys = new Set(items.map(this.keyOf));
    for (const [key, element] of this.elements) if (!keys.has(key)) this.remove(key, element);
    const elements = items.map((item) => this.elements.get(this.keyOf(item)) ?? this.add(item));
    arrange(this.container, elements);
    items.forEach((item, place) => this.fill(elements[place], item, place));
  }

  // What is shown keeps its place, and what is new comes last: a button must not move away from under a finger.
  showInPlace(items) {
    const places = new Map([...this.elements.keys()].map((key, place) => [key, place]));
    const place = (item) => places.get(this.keyOf(item)) ?? places.size;
    this.show([...items].sort((one, other) => place(one) - place(other)));
  }

  add(item) {
    const element = this.make(item);
    this.elements.set(this.keyOf(item), element);
    return element;
  }

  remove(key, element) {
    element.remove();
    this.elements.delete(key);
  }
}

// Brings elements into this order. One that goes further back or to the front moves alone.
export function arrange(container, elements) {
  let next = container.firstElementChild;
  for (const element of elements) {
    if (next !== element && next?.nextElementSibling === element) next = element; // the one before it goes further back
    if (next === element) next = element.nextElementSibling;
    else container.insertBefore(element, next);
  }
}

// Gives the function that makes an element as the template with this id has it.
export const madeBy = (id) => () => cloned(/** @type {HTMLTemplateElement} */ (document.getElementById(id)));

/** @returns {any} */
export const cloned = (/** @type {HTMLTemplateElement} */ template) => template.content.firstElementChild?.cloneNode(true);
