import assert from "node:assert/strict";
import { beforeEach, mock, test } from "node:test";

import { Question } from "../../src/control/controlPanel.js";

let clock, held, element, question;

beforeEach(() => {
  mock.timers.reset();
  mock.timers.enable({ apis: ["setInterval"] });
  clock = 5000;
  held = false;
  element = new EventTarget();
  Object.assign(element, { hidden: true, dataset: {} });
  question = new Question(element, { busy: () => held, now: () => clock });
});

// Whether a click gets through to a button.
function click() {
  let heard = false;
  const hear = () => (heard = true);
  element.addEventListener("click", hear);
  const event = new Event("click", { cancelable: true });
  const stop = event.stopPropagation.bind(event);
  let stopped = false;
  event.stopPropagation = () => ((stopped = true), stop());
  element.dispatchEvent(event);
  element.removeEventListener("click", hear);
  return heard && !stopped;
}

test("a question is deaf for its first 1.2 s", () => {
  question.show(true);
  assert.equal(click(), false);
  clock += 1190;
  assert.equal(click(), false);
  clock += 20;
  assert.equal(click(), true);
});

test("a question that goes and comes again is new", () => {
  question.show(true);
  clock += 1300;
  question.show(true);
  assert.equal(click(), true);
  question.show(false);
  question.show(true);
  assert.equal(click(), false);
});

test("a question is deaf while a key or stick is held, and looks so", () => {
  question.show(true);
  clock += 1300;
  held = true;
  assert.equal(click(), false);
  mock.timers.tick(100);
  assert.equal(element.dataset.deaf, "true");
  held = false;
  assert.equal(click(), true);
  mock.timers.tick(100);
  assert.equal(element.dataset.deaf, "false");
});
