import assert from "node:assert/strict";
import { test } from "node:test";

import { Snapshots, Queue, firstTopic, lackOf } from "../../src/fleet/thumbs.js";

const settle = () => new Promise((resolve) => setImmediate(resolve));

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

test("what is no longer wanted never begins, or is cut", async () => {
  const queue = new Queue(1);
  const signals = [];
  const job = (signal) => new Promise((resolve) => (signals.push(signal), signal.addEventListener("abort", resolve)));
  const first = queue.add(job);
  const second = queue.add(job);
  queue.add(job);
  second();
  first();
  await settle();
  assert.equal(signals.length, 2);
  assert.deepEqual(
    signals.map(({ aborted }) => aborted),
    [true, false],
  );
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

test("the first camera is what web_video_server names first", () => {
  const page =
    '<a href="/stream_viewer?topic=/front/image">/front/image</a> (<a href="/snapshot?topic=%2Ffront%2Fimage">Snapshot</a>) (<a href="/snapshot?topic=/rear">Snapshot</a>)';
  assert.equal(firstTopic(page), "/front/image");
  assert.equal(firstTopic("<h1>Available ROS Image Topics:</h1>"), "");
});

function serverThat(answers) {
  const asked = [];
  const fetch = async (url) => {
    asked.push(url);
    const { status = 200, text = "", code } = answers(url);
    return { ok: status < 400, status, text: async () => text, json: async () => ({ code }), blob: async () => "picture" };
  };
  return { asked, snapshots: new Snapshots({ fetch }) };
}

test("a picture is small, and of the camera that the settings name", async () => {
  const { asked, snapshots } = serverThat(() => ({}));
  const { signal } = new AbortController();
  assert.deepEqual(await snapshots.fetchImage("sim 1", "/front", signal), { blob: "picture" });
  assert.deepEqual(asked, ["/robots/sim%201/video/snapshot?topic=/front&width=320&height=240&quality=50"]);
});

test("a robot whose camera nobody named is asked once", async () => {
  const { asked, snapshots } = serverThat(() => ({ text: '"/snapshot?topic=/front"' }));
  const { signal } = new AbortController();
  await snapshots.fetchImage("sim1", "", signal);
  await snapshots.fetchImage("sim1", "", signal);
  assert.equal(asked.filter((url) => url.endsWith("/video/")).length, 1);
});

test("a robot whose camera gives no picture any more is asked for another one", async () => {
  let camera = "/front";
  const { snapshots } = serverThat((url) =>
    url.endsWith("/video/") ? { text: `"/snapshot?topic=${camera}"` } : { status: url.includes(`topic=${camera}&`) ? 200 : 502 },
  );
  const { signal } = new AbortController();
  const fetched = async () => Object.keys(await snapshots.fetchImage("sim1", "", signal));
  await fetched();
  camera = "/rear";
  assert.deepEqual([await fetched(), await fetched()], [["problem", "topic"], ["blob"]]);
});

test("why there is no picture is told apart", async () => {
  const { signal } = new AbortController();
  const found = (answer, topic = "/front") => serverThat(() => answer).snapshots.fetchImage("sim1", topic, signal);
  const refused = async (code, topic) => (await found({ status: 502, code }, topic)).problem;
  assert.deepEqual(
    [await refused("robot_offline"), await refused("video_down"), await refused("other")],
    ["offline", "video_down", "failed"],
  );
  assert.deepEqual(await found({ status: 502, code: "no_frames" }), { problem: "no_frames", topic: "/front" });
  assert.deepEqual([(await found({}, "")).problem, await refused("robot_offline", "")], ["no_camera", "offline"]);
});
