import assert from "node:assert/strict";
import { test } from "node:test";

import { Api, backoff, framesUrl, rosUrl, streamUrl } from "../../src/client/api.js";
import { reasons } from "../../src/texts/common.js";

const SERVER = "https://robots.example:8443";

for (const [what, address, expected] of [
  ["a name and a ticket stay what they are", rosUrl(SERVER, "sim 1", "a+b"), "wss://robots.example:8443/robots/sim%201/ros?ticket=a%2Bb"],
  ["so does a topic", framesUrl(SERVER, "sim1", "/cam/raw"), "wss://robots.example:8443/robots/sim1/video/frames?topic=/cam/raw"],
  ["of a page only the host counts", framesUrl("http://lab/x?y#z", "a", "/c", "t"), "ws://lab/robots/a/video/frames?topic=/c&ticket=t"],
  ["a stream has more", streamUrl(SERVER, "a", "/c", "t", { fps: 5 }), `${SERVER}/robots/a/video/stream?topic=/c&fps=5&ticket=t`],
]) {
  test(`addresses: ${what}`, () => assert.equal(address, expected));
}

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
