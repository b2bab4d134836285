import assert from "node:assert/strict";
import { test } from "node:test";

import { Choices, decimalText, freshPage, LocalStore, shortNumber, sizeText } from "../../src/dom/page.js";
import { storageOf } from "../fakes.js";

test("what is not JSON, what was never written, and all of a browser that keeps nothing, is nothing", () => {
  const store = storageOf(new Map([["robotether.sticks", "{"]]));
  const blocked = () => {
    throw new Error("blocked");
  };
  for (const kept of [new LocalStore(() => store), new LocalStore(blocked)]) {
    assert.deepEqual([kept.read("sticks"), kept.read("other")], [null, null]);
  }
  const kept = new LocalStore(blocked);
  kept.write("sticks", true);
  kept.forget("sticks");
});

test("choices are those of their name, nonsense is none, and what is chosen anew leaves the others", () => {
  const store = storageOf(new Map([["robotether.sight.sim2", "7"]]));
  const choices = (name) => new Choices(name, new LocalStore(() => store));
  choices("sight.sim1").keep({ quality: "50" });
  choices("sight.sim1").keep({ laser: true });
  assert.deepEqual(choices("sight.sim1").all, { quality: "50", laser: true });
  assert.deepEqual([choices("sight.sim2").all, choices("sight.sim3").all], [{}, {}]);
});

test("numbers are short and still tell small from none", () => {
  const numbers = [0, 0.12345, -1.5, 123456.7, 0.0001234, 2.5e12, NaN];
  assert.equal(numbers.map(shortNumber).join(), "0,0.123,-1.5,123457,1.23e-4,2.50e+12,-");
  assert.deepEqual(
    [
      [-0.04, 1],
      [12.345, 2],
      [-0.4, 0],
      [-1e20, 1],
    ].map(([value, decimals]) => decimalText(value, decimals)),
    ["0.0", "12.35", "0", "-1.0e+20"],
  );
});

test("a size has the figures that count, at each end of its unit", () => {
  const sizes = [999, 1500, 9949, 9950, 99_960, 999_950, 1.5e6].map(sizeText);
  assert.deepEqual(sizes, ["999 B", "1.5 KB", "9.9 KB", "10 KB", "100 KB", "1000 KB", "1.5 MB"]);
});

test("a page that comes late does not take the place of one that was asked for after it", async () => {
  const answers = [];
  globalThis.fetch = () => new Promise((answer) => answers.push((text) => answer({ ok: true, text: async () => text })));
  globalThis.DOMParser = class {
    parseFromString = (text) => ({ text, querySelectorAll: () => [] });
  };
  const pages = [freshPage("/routes"), freshPage("/routes"), freshPage("/routes")];
  answers[1]("new");
  assert.equal((await pages[1]).text, "new");
  answers[0]("old");
  assert.equal(await pages[0], null);
  answers[2]("newest");
  assert.equal((await pages[2]).text, "newest");
});
