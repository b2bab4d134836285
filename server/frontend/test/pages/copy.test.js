import assert from "node:assert/strict";
import { test } from "node:test";

import { wireCopyButtons } from "../../src/pages/copy.js";

function pageWith(text) {
  const button = {
    dataset: { copy: "line" },
    textContent: "Copy",
    hidden: true,
    addEventListener: (_, listener) => {
      button.click = listener;
    },
  };
  const page = {
    querySelectorAll: () => [button],
    getElementById: (id) => (id === "line" ? { textContent: text } : null),
  };
  return { button, page };
}

test("a button copies the text of its element, and says so for a while", async (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const { button, page } = pageWith("curl ... | sudo sh");
  const copied = [];
  wireCopyButtons(page, {
    writeText: async (text) => {
      copied.push(text);
    },
  });
  assert.equal(button.hidden, false);
  await button.click();
  assert.deepEqual(copied, ["curl ... | sudo sh"]);
  assert.equal(button.textContent, "Copied");
  t.mock.timers.tick(2000);
  assert.equal(button.textContent, "Copy");
});

test("a browser that refuses says to copy by hand", async (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const { button, page } = pageWith("text");
  wireCopyButtons(page, {
    writeText: async () => {
      throw new Error("not allowed");
    },
  });
  await button.click();
  assert.equal(button.textContent, "Select and copy by hand");
});

test("without a clipboard the button stays hidden", () => {
  const { button, page } = pageWith("text");
  wireCopyButtons(page, undefined);
  assert.equal(button.hidden, true);
});
