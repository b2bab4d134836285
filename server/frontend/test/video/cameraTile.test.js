import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";

import { CameraTile } from "../../src/video/cameraTile.js";

let clock, streams, parts, element, tile, paintings;

const part = () => ({ textContent: "", setAttribute() {} });

// A stream that does what the test says, in place of client/frames.js.
function openFrames(topic, options) {
  const stream = { topic, ...options, asked: [options.want], started: false };
  stream.start = () => (stream.started = true);
  stream.stop = () => (stream.started = false);
  stream.want = (want) => stream.asked.push(want);
  streams.push(stream);
  return stream;
}

// Snapshots stand on the page when the test says so.
const painter = () => ({
  turned: 0,
  show: (jpeg) => new Promise((done, failed) => paintings.push({ jpeg, done, failed })),
});

beforeEach(() => {
  clock = 1000;
  streams = [];
  paintings = [];
  parts = { picture: part(), words: part(), facts: part() };
  element = {
    dataset: { main: "true" },
    clientWidth: 800,
    clientHeight: 600,
    querySelector: (selector) => parts[/"(.+)"/.exec(selector)[1]],
    remove() {},
  };
  tile = new CameraTile(element, {
    camera: { topic: "/front", name: "front" },
    openFrames,
    wanted: () => ({ fps: 15 }),
    set: { width: null, height: null },
    oldMs: 1000,
    onPainted: () => {},
    now: () => clock,
    painter: painter(),
  });
  tile.start();
});

async function paint(at, size = { width: 640, height: 480 }) {
  const shown = streams.at(-1).onFrame({ jpeg: new Uint8Array(), at });
  paintings.at(-1).done(size);
  await shown;
}

test("a picture counts from when it stands on the page, with the moment at which it was taken", async () => {
  const shown = streams[0].onFrame({ jpeg: new Uint8Array(), at: 900 });
  assert.deepEqual([tile.at, tile.state], [null, "none"]);
  paintings[0].done({ width: 640, height: 480 });
  await shown;
  assert.deepEqual([tile.at, tile.state, element.dataset.picture], [900, "live", "live"]);
});

test("a picture that cannot be decoded is none", async () => {
  const shown = streams[0].onFrame({ jpeg: new Uint8Array(), at: 900 });
  paintings[0].failed(new Error("broken"));
  await assert.rejects(shown);
  assert.equal(tile.at, null);
});

test("an old picture stays with words and its age", async () => {
  await paint(900);
  streams[0].onStatus({ picture: "none", why: "link_lost", detail: "" });
  clock = 13_900;
  tile.showState();
  assert.equal(element.dataset.picture, "old");
  assert.match(parts.words.textContent, /^This picture is old. The link to the robot was lost/);
  assert.match(parts.facts.textContent, /^13 s old/);
});

test("why a tile was stopped is said, also of one that played nothing", async () => {
  tile.stop("login_missing");
  assert.equal(parts.words.textContent, "Your login has ended.");
  tile.stop("rights_ended");
  assert.equal(parts.words.textContent, "Your rights have changed.");
});

test("a picture that is decoded after the stream has ended counts no more", async () => {
  const shown = streams[0].onFrame({ jpeg: new Uint8Array(), at: 900 });
  tile.stop();
  tile.start();
  paintings[0].done({ width: 640, height: 480 });
  await shown;
  assert.equal(tile.at, null);
  assert.deepEqual(streams.map(({ started }) => started), [false, true]);
});

test("a small tile asks for less as soon as the camera's size is known, and once", async () => {
  Object.assign(element, { clientWidth: 300, clientHeight: 225 });
  await paint(900);
  await paint(950, { width: 320, height: 240 });
  tile.ask();
  assert.deepEqual(streams[0].asked.slice(1), [{ fps: 15, width: 320, height: 240 }]);
});

test("after a sleep of the machine the picture is not trusted, and the next one is", async () => {
  await paint(900);
  tile.forget();
  assert.equal(tile.state, "none");
  await paint(990);
  assert.equal(tile.state, "live");
});

test("before the first picture the reason is told in words", async () => {
  streams[0].onStatus({ picture: "none", why: "down", detail: "no such topic" });
  assert.equal(parts.words.textContent, "The camera does not answer: no such topic.");
  streams[0].onStatus({ picture: "none", why: "a word of a newer client", detail: "" });
  assert.equal(parts.words.textContent, "The camera sends no picture.");
});
