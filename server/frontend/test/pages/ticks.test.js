import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { part } from "../../src/dom/page.js";
import { Ticks } from "../../src/pages/ticks.js";
import { FakeElement } from "../fakes.js";

const press = (element) => element.dispatchEvent(new Event("click", { cancelable: true }));

let view, page, bar, rows, others, links, form, all;

// A list with robots `names` on this page, and `elsewhere` on others.
function open(names, elsewhere = []) {
  rows = names.map((value) => {
    const row = { hidden: false };
    row.box = { name: "robot", value, checked: false, closest: () => row };
    return row;
  });
  others = elsewhere.map((value) => ({ value, remove: () => (others = others.filter((other) => other.value !== value)) }));
  links = [{ href: "https://a.example/admin/robots?q=lab&page=2" }];
  [form, all] = [new FakeElement(), new FakeElement()];
  bar = Object.assign(new FakeElement(), { dataset: { one: "robot" } });
  const found = {
    'input[type="checkbox"][name="robot"]': () => rows.map(({ box }) => box),
    'input[type="hidden"][name="robot"]': () => others,
    '[data-part="ticks-all"]': () => [all],
    "form[data-keeps-ticks]": () => [form],
    "a[data-keeps-ticks]": () => links,
  };
  page = Object.assign(new FakeElement(), { querySelectorAll: (query) => found[query]() });
  view = new EventTarget();
  view.location = { href: "https://a.example/admin/robots?q=lab" };
  view.history = { state: null, replaceState: (_state, _title, href) => (view.location.href = href) };
  new Ticks(page, bar, view).wire();
}

const count = () => part(bar, "ticks-count").textContent;

function tick(name, checked = true) {
  const { box } = rows.find((row) => row.box.value === name);
  box.checked = checked;
  page.dispatchEvent(Object.defineProperty(new Event("change"), "target", { value: box }));
}

beforeEach(() => open(["sim1", "sim2"], ["sim8", "sim9"]));

test("what is ticked is counted, with what is on other pages or hidden by a search", () => {
  assert.deepEqual([bar.hidden, count()], [false, "2 robots ticked, 2 not shown here"]);
  tick("sim1");
  assert.equal(count(), "3 robots ticked, 2 not shown here");
  rows[0].hidden = true;
  page.dispatchEvent(new Event("input"));
  assert.equal(count(), "3 robots ticked, 3 not shown here");
});

test("other pages and searches of the list keep it, and so does a reload", () => {
  tick("sim2");
  const kept = "robot=sim8&robot=sim9&robot=sim2";
  assert.equal(links[0].href, `https://a.example/admin/robots?q=lab&page=2&${kept}`);
  assert.equal(view.location.href, `https://a.example/admin/robots?q=lab&${kept}`);
  const formData = new FormData();
  form.dispatchEvent(Object.assign(new Event("formdata"), { formData }));
  assert.deepEqual(formData.getAll("robot"), ["sim8", "sim9", "sim2"]);
  tick("sim2", false);
  assert.equal(view.location.href, "https://a.example/admin/robots?q=lab&robot=sim8&robot=sim9");
});

test("it is cleared everywhere at once", () => {
  tick("sim1");
  press(part(bar, "ticks-clear"));
  assert.deepEqual([bar.hidden, rows[0].box.checked, others], [true, false, []]);
  assert.equal(links[0].href, "https://a.example/admin/robots?q=lab&page=2");
});

test("one press ticks all that is shown, and the next none of it", () => {
  rows[1].hidden = true;
  assert.equal(all.hidden, false);
  for (const expected of [true, false]) {
    press(all);
    assert.deepEqual([rows[0].box.checked, rows[1].box.checked], [expected, false]);
  }
  assert.equal(count(), "2 robots ticked, 2 not shown here");
});

test("no more is ticked than an address holds", () => {
  const names = Array.from({ length: 120 }, (_, at) => `sim${at}`);
  open(names, ["last"]);
  press(all);
  const ticked = () => rows.filter(({ box }) => box.checked).length;
  assert.equal(ticked(), 99);
  assert.equal(count(), "100 robots ticked, 1 not shown here. At most 100 robots at once.");
  tick("sim119");
  assert.equal(ticked(), 99);
});
