// The robots as elements, cards or rows of a table: one list, in order, with what is filtered out hidden.
// The markup is the server's; cards.js fills it in.

import { fillCard, newCard } from "./cards.js";
import { itemsToMove } from "./reorder.js";

export class RobotList {
  // `container` holds the elements, `template` makes one for a robot that has none yet; `onNew(element, name)` for each.
  constructor({ container, template, onNew }) {
    Object.assign(this, { container, template, onNew });
    this.elements = new Map([...container.children].map((element) => [element.dataset.robot, element]));
    for (const [name, element] of this.elements) onNew(element, name);
  }

  // Makes what is missing; a robot that is new comes last until the next `arrange`.
  fill(robot, shown) {
    if (!this.elements.has(robot.name)) this.add(robot, shown);
    fillCard(this.elements.get(robot.name), robot);
  }

  add(robot, shown) {
    const element = newCard(this.template, robot);
    element.hidden = !shown;
    this.elements.set(robot.name, element);
    this.container.append(element);
    this.onNew(element, robot.name);
  }

  // `paused`: nothing may move, so what goes leaves its place empty.
  remove(name, paused) {
    const element = this.elements.get(name);
    this.elements.delete(name);
    if (paused && element) vacate(element);
    else element?.remove();
  }

  // `names` in order, each with an element; `shown` says which of them are.
  arrange(names, shown) {
    for (const left of this.container.querySelectorAll("[data-left]")) left.remove();
    const present = [...this.container.children].map(({ dataset }) => dataset.robot);
    const moving = itemsToMove(present, names);
    const focused = document.activeElement;
    let next = null;
    for (const name of [...names].reverse()) {
      const element = this.elements.get(name);
      if (moving.has(name)) this.container.insertBefore(element, next);
      if (element.hidden === shown.has(name)) element.hidden = !shown.has(name);
      next = element;
    }
    // An element that moves loses the keyboard focus.
    if (focused !== document.activeElement && this.container.contains(focused)) focused.focus({ preventScroll: true });
  }
}

function vacate(element) {
  element.dataset.left = "";
  for (const name of ["robot", "testid"]) delete element.dataset[name];
  element.setAttribute("aria-hidden", "true");
  element.inert = true;
}
