import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import { Banner } from "../../src/control/controlPanel.js";
import { LINK_LOST, LIVE } from "../../src/client/connection.js";

let before, clock, actions, parts, banner;

beforeEach(() => {
  before = globalThis.document;
  globalThis.document = { activeElement: null };
  clock = 1000;
  actions = [];
  const button = Object.assign(new EventTarget(), { hidden: true, textContent: "" });
  parts = { "state-title": {}, "state-detail": {}, "state-action": button };
  const element = { dataset: {}, querySelector: (selector) => parts[/"(.+)"/.exec(selector)[1]] };
  banner = new Banner(
    { querySelector: () => element },
    { onRetry: () => actions.push("retry"), onBlind: () => actions.push("blind"), now: () => clock },
  );
});

afterEach(() => {
  globalThis.document = before;
});

const held = () => banner.show(LIVE, { control: {}, driving: true, video: "missing" });
const press = () => parts["state-action"].dispatchEvent(new Event("click"));

test("a press that was meant for what the button was before lets nobody drive without a picture", () => {
  banner.show(LINK_LOST, {});
  press();
  held();
  press();
  clock += 1199;
  held();
  press();
  assert.deepEqual(actions, ["retry"]);
  assert.equal(parts["state-action"].textContent, "Drive without video");
});

test("who has had the time to read it, or saw no button before, may drive without a picture", () => {
  banner.show(LINK_LOST, {});
  held();
  clock += 1200;
  press();
  banner.show(LIVE, { control: {}, driving: true, video: "seen" });
  clock += 1200;
  held();
  press();
  assert.deepEqual(actions, ["blind", "blind"]);
});
