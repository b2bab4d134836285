import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { part } from "../../src/dom/page.js";
import { Queue, Thumb, fetchSnapshot, lackOf } from "../../src/fleet/thumbs.js";
import { FakeElement, settle } from "../fakes.js";

mock.timers.enable({ apis: ["setTimeout"] });

test("so many pictures are got at once, the others wait their turn", async () => {
  const queue = new Queue(2);
  const begun = [];
  const ends = [];
  for (let i = 0; i < 4; i++) queue.add(() => new Promise((resolve) => (begun.push(i), ends.push(resolve))));
  assert.deepEqual(begun, [0, 1]);
  ends[0]();
  await settle();
  assert.deepEqual(begun, [0, 1, 2]);
});

test("what is no longer wanted never begins, or is cut, as is what takes over 10 s", async () => {
  const queue = new Queue(1);
  const signals = [];
  const job = (signal) => new Promise((resolve) => (signals.push(signal), signal.addEventListener("abort", resolve)));
  const [first, second] = [queue.add(job), queue.add(job), queue.add(job)];
  second();
  first();
  await settle();
  const aborted = () => signals.map((signal) => signal.aborted);
  mock.timers.tick(9999);
  assert.deepEqual(aborted(), [true, false]);
  mock.timers.tick(1);
  assert.deepEqual(aborted(), [true, true]);
});

test("a job that fails holds up nobody", async () => {
  const queue = new Queue(1);
  let begun = 0;
  queue.add(async () => {
    throw new Error("no network");
  });
  queue.add(async () => (begun += 1));
  await settle();
  assert.equal(begun, 1);
});

test("a robot without video is asked for no picture, and one whose video is not known is", () => {
  assert.equal(lackOf({ online: "true", video: "down" }), "video_down");
  assert.equal(lackOf({ online: "false", video: "up" }), "empty");
  for (const video of ["up", "", undefined]) assert.equal(lackOf({ online: "true", video }), "");
});

test("while a robot waits its turn, its picture of before goes", () => {
  const box = new FakeElement();
  const thumb = new Thumb(box, { robot: "sim1", card: { dataset: { online: "true" } }, queue: { add: () => () => {} } });
  thumb.show({ blob: new Blob() });
  thumb.later(5000);
  for (const [ms, state] of /** @type {[number, string][]} */ ([
    [5000, "shown"],
    [9999, "shown"],
    [1, "waiting"],
  ])) {
    mock.timers.tick(ms);
    assert.deepEqual([box.dataset.thumb, part(box, "thumb-image").hidden], [state, state === "waiting"]);
  }
});

function serverThat({ status = 200, type = "application/json", body = "" }) {
  const asked = [];
  mock.method(globalThis, "fetch", async (url) => {
    asked.push(url);
    return new Response(body, { status, headers: { "Content-Type": type } });
  });
  return { asked, fetchImage: (topic) => fetchSnapshot("sim 1", { topic, mac: "00:1b:44:11:3a:b7" }, new AbortController().signal) };
}

test("why there is no picture is told apart, in the words of who knows it", async () => {
  const refused = async (code, detail) => await serverThat({ status: 502, body: JSON.stringify({ code, detail }) }).fetchImage("/front");
  assert.deepEqual(await refused("robot_offline", "offline since 12:03"), { problem: "offline", detail: "offline since 12:03" });
  assert.deepEqual(await refused("video_down", "it hangs"), { problem: "video_down", detail: "it hangs" });
  assert.deepEqual(await refused("no_frames", "no frames"), { problem: "failed", detail: "no frames" });
  const depth = serverThat({ status: 503, type: "text/plain; charset=utf-8", body: "it has the encoding 16UC1\n" });
  assert.deepEqual(await depth.fetchImage(undefined), { problem: "failed", detail: "it has the encoding 16UC1" });
  const { searchParams } = new URL(depth.asked[0], "https://server"); // another robot may have the name
  assert.deepEqual([searchParams.get("topic"), searchParams.get("mac")], [null, "00:1b:44:11:3a:b7"]);
});
