import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { showLocalTimes } from "../../src/dom/page.js";
import { isNew } from "../../src/dom/presses.js";
import { USUAL_ENDS } from "../../src/pages/grants.js";
import { dayOf, startOrEnd, wireDays } from "../../src/pages/desk.js";
import { FakeElement } from "../fakes.js";

// Behind UTC in winter and ahead of it in summer, so that no test passes by the zone that the machine has.
process.env.TZ = "Atlantic/Azores";

test("times are the reader's own, with seconds, and with a year that is not this one", () => {
  const times = ["2026-01-31T00:03:59+00:00", "2025-07-01T12:00:00+00:00", "2026-06-01T00:00:00Z", "2026-05-31T23:59:59Z"].map(
    (dateTime) => ({ dateTime, textContent: "UTC" }),
  );
  showLocalTimes({ querySelectorAll: () => times }, new Date("2026-06-01T12:00:00Z"));
  const texts = times.map(({ textContent }) => textContent);
  assert.deepEqual(texts, ["30 Jan 23:03:59", "1 Jul 2025 12:00:00", "today 00:00:00", "yesterday 23:59:59"]);
});

test("a page takes no press that began elsewhere, nor a double one on what opened it or on a form", async () => {
  const wired = [];
  const hear = (name) => wired.push(name);
  const question = new FakeElement();
  const querySelectorAll = (selector) => (selector === "[data-settles]" ? [question] : []);
  Object.defineProperty(globalThis, "navigator", { value: {}, configurable: true }); // older Nodes have none
  Object.assign(globalThis, { document: { querySelectorAll, addEventListener: hear }, window: { addEventListener: hear } });
  const every = mock.method(globalThis, "setInterval", () => 0);
  await import("../../src/pages/desk.js?page");
  every.mock.restore();
  for (const name of ["document", "window"]) delete globalThis[name];
  assert.deepEqual(wired, ["pointerdown", "click", "keydown", "submit"]);
  assert.equal(isNew(question), true);
});

test("a day begins and ends in the reader's zone", () => {
  assert.equal(startOrEnd("2026-01-31", false), "2026-01-31T01:00:00Z");
  assert.equal(startOrEnd("2026-01-31", true), "2026-02-01T01:00:00Z");
  assert.equal(dayOf("2026-01-31T01:00:00Z", false), "2026-01-31");
  assert.equal(dayOf("2026-02-01T01:00:00Z", true), "2026-01-31");
  assert.equal(dayOf("2026-01-31", true), "2026-01-31");
  assert.equal(dayOf("", true), "");
});

test("a filter asks for the reader's days, and for nothing where no day is given", () => {
  const field = (name, at) => ({ name, value: "", dataset: { at } });
  const days = [field("since", "2026-01-31T01:00:00Z"), field("until", "")];
  const form = {
    querySelectorAll: (selector) => (selector === "[data-day]" ? days : []),
    addEventListener: (_, listener) => {
      form.sent = (formData) => listener({ formData });
    },
  };
  wireDays(form);
  assert.equal(days[0].value, "2026-01-31");
  days[0].value = "2026-07-01";
  const query = new Map([["until", ""]]);
  form.sent(query);
  assert.deepEqual(Object.fromEntries(query), { since: "2026-07-01T00:00:00Z", until: "" });
});

test("the usual ends are in the reader's own time, and seven days are so over a change of clocks", () => {
  assert.deepEqual(Object.fromEntries(USUAL_ENDS.map(([words, end]) => [words, end(new Date("2026-03-25T12:03:59Z"))])), {
    "1 h": "2026-03-25T12:03",
    Today: "2026-03-25T23:59",
    "7 days": "2026-04-01T11:03",
    "No end": "",
  });
});
