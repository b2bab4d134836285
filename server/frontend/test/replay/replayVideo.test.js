import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { part } from "../../src/dom/page.js";
import { KeyFrameMissingError } from "../../src/decoders/streamDecoder.js";
import { ReplayVideo, camerasOf, frameOf } from "../../src/replay/replayVideo.js";
import { FakeElement, settle } from "../fakes.js";

let shown, decoded, element, video, fails;

const frame = (atMs, codec = "h264", isKey = false) => ({ codec, isKey, data: Uint8Array.from([1]), atMs });
const words = (atMs, loading = false) => {
  video.show(atMs, { isRecorded: true, loading });
  return part(element, "words").textContent;
};

beforeEach(() => {
  shown = [];
  decoded = [];
  fails = () => null;
  element = new FakeElement();
  video = new ReplayVideo(element, {
    painter: { show: (image) => shown.push(image.atMs) },
    makeDecoder: () => ({
      close() {},
      async decode({ atMs }) {
        decoded.push(atMs);
        const error = fails(atMs);
        if (error) throw error;
        return { atMs, close() {} };
      },
    }),
  });
});

test("a seek decodes from the key frame on and shows the last frame alone", async () => {
  video.reset([frame(0, "h264", true), frame(100), frame(200)]);
  await settle();
  assert.deepEqual([decoded, shown], [[0, 100, 200], [200]]);
  assert.deepEqual([words(300), element.dataset.frame], ["", "live"]);
});

test("of JPEG only what is shown is decoded", async () => {
  video.push([frame(0, "jpeg", true), frame(100, "jpeg", true), frame(200, "jpeg", true)]);
  await settle();
  assert.deepEqual(decoded, [200]);
});

test("a frame that does not decode leaves no older picture, and the next one may", async () => {
  fails = (atMs) => (atMs === 100 ? new Error("no video") : null);
  video.push([frame(0, "jpeg", true)]);
  await settle();
  video.push([frame(100, "jpeg", true)]);
  await settle();
  assert.deepEqual([words(150), element.dataset.frame], ["This browser cannot decode the video here.", "none"]);
  video.push([frame(200, "jpeg", true)]);
  await settle();
  assert.deepEqual([words(250), shown], ["", [0, 200]]);
});

test("where no video is recorded no video is shown", async () => {
  video.push([frame(0, "jpeg", true)]);
  await settle();
  assert.deepEqual([words(1000), words(5000), element.dataset.frame], ["", "No video is recorded here.", "none"]);
  assert.equal(words(5000, true), "Loading.");
  fails = () => new KeyFrameMissingError();
  video.push([frame(6000)]);
  await settle();
  assert.equal(words(6000), "The video starts at the next key frame.");
});

test("cameras are what the recorder wrote of one, in the drive page's order", () => {
  const image = "sensor_msgs/msg/CompressedImage";
  const topics = [
    { name: "/rear/compressed", type: image },
    { name: "/front/compressed", type: image },
    { name: "/front/video", type: "foxglove_msgs/msg/CompressedVideo" },
    { name: "/<script>/compressed", type: image },
    { name: "/odom/compressed", type: "nav_msgs/msg/Odometry" },
    { name: "/video", type: "foxglove_msgs/msg/CompressedVideo" },
  ];
  const cameras = (order) => camerasOf(topics, order).map(({ name, topics }) => `${name}: ${topics.length}`);
  assert.deepEqual(cameras([]), ["/<script>: 1", "/front: 2", "/rear: 1"]);
  assert.deepEqual(cameras(["/rear", "/gone", "/front"]), ["/rear: 1", "/front: 2", "/<script>: 1"]);
  for (const message of [null, {}, { format: "jpeg", data: "text" }, { format: "av1", data: new Uint8Array(2) }]) {
    assert.equal(frameOf(message, 0), null);
  }
});
