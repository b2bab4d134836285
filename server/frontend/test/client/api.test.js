import assert from "node:assert/strict";
import { test } from "node:test";

import { Api, backoff } from "../../src/client/api.js";
import { reasons } from "../../src/texts/common.js";

const first = (random) => {
  const delays = backoff(() => random);
  return Array.from({ length: 6 }, () => delays.next().value).join();
};

test("delays double from half a second to five, and jitter takes off at most half of them", () => {
  assert.deepEqual([first(1), first(0)], ["500,1000,2000,4000,5000,5000", "500,500,1000,2000,2500,2500"]);
});

for (const [what, answer, expected] of [
  ["an answer without content is the server's", new Response(null, { status: 204 }), [true, 204, ""]],
  ["so is a refusal in JSON", Response.json({ detail: "cannot stop: no" }, { status: 403 }), [false, 403, "cannot stop: no"]],
  ["the page of a proxy stops no robot", new Response("<h1>Log in</h1>"), [false, 0, reasons.between]],
  ["nor does it refuse for good", new Response("404 page not found", { status: 404 }), [false, 0, reasons.between]],
]) {
  test(`answers: ${what}`, async (context) => {
    context.mock.method(globalThis, "fetch", async () => answer);
    const { ok, status, detail } = await new Api().stop("sim1");
    assert.deepEqual([ok, status, detail], expected);
  });
}
