import assert from "node:assert/strict";
import { test } from "node:test";

import { backoff, framesUrl, rosUrl, streamUrl } from "../../src/client/api.js";

const SERVER = "https://robots.example:8443";

test("WebSockets are wss, and names and topics are written so that they stay what they are", () => {
  assert.equal(rosUrl(SERVER, "sim 1", "a+b"), "wss://robots.example:8443/robots/sim%201/ros?ticket=a%2Bb");
  assert.equal(
    framesUrl(SERVER, "sim1", "/camera/image_raw"),
    "wss://robots.example:8443/robots/sim1/video/frames?topic=/camera/image_raw",
  );
});

test("of a page's own address only the host counts", () => {
  assert.equal(
    framesUrl("http://localhost/robots/sim1?x#y", "sim1", "/c", "t"),
    "ws://localhost/robots/sim1/video/frames?topic=/c&ticket=t",
  );
});

test("a stream has what it is asked for", () => {
  assert.equal(streamUrl(SERVER, "sim1", "/c", "t", { quality: 50 }), `${SERVER}/robots/sim1/video/stream?topic=/c&quality=50&ticket=t`);
});

const first = (count, random) => {
  const delays = backoff(random);
  return Array.from({ length: count }, () => delays.next().value);
};

test("delays double from half a second and stay at five seconds", () => {
  assert.deepEqual(
    first(6, () => 1),
    [500, 1000, 2000, 4000, 5000, 5000],
  );
});

test("jitter takes off at most half and never goes below half a second", () => {
  assert.deepEqual(
    first(6, () => 0),
    [500, 500, 1000, 2000, 2500, 2500],
  );
});
