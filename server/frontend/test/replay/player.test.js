import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { setImmediate as turn } from "node:timers/promises";

import { Player } from "../../src/replay/player.js";
import { settle } from "../fakes.js";

const TOPICS = { recent: ["/state"], newest: ["/map"], fixed: ["/static"], frames: ["/video"], isKey: ({ data }) => data[0] === 1 };
const DURATION_MS = 20_000;

let clock, player, handed, reset, gate;

const message = (topic, atMs, data = [0]) => ({ topic, atMs, data: Uint8Array.from(data) });
// A key frame each five seconds, a state each 100 ms, a map at the beginning.
const MESSAGES = [message("/map", 0), message("/static", 10)];
for (let atMs = 0; atMs <= DURATION_MS; atMs += 100) {
  MESSAGES.push(message("/state", atMs), message("/video", atMs, [Number(atMs % 5000 === 0)]));
}

function readerOf(messages) {
  const chosen = (topics, from, to) => messages.filter(({ topic, atMs }) => topics.includes(topic) && atMs >= from && atMs <= to);
  return {
    durationMs: DURATION_MS,
    async *messages({ topics, afterMs = -1, toMs = DURATION_MS }) {
      await gate;
      yield* chosen(topics, afterMs + 0.001, toMs);
    },
    async *backwards({ topics, fromMs = 0, toMs }) {
      yield* chosen(topics, fromMs, toMs).reverse();
    },
  };
}

function make(messages = MESSAGES) {
  player = new Player({
    reader: readerOf(messages),
    topics: TOPICS,
    onReset: (list, atMs) => reset.push({ list, atMs }),
    onMessages: (list) => handed.push(...list),
    onState: () => {},
    now: () => clock,
  });
}

async function run(ms) {
  for (let passed = 0; passed < ms; passed += 50) {
    clock += 50;
    player.tick();
    await turn();
  }
}

beforeEach(() => {
  clock = 0;
  handed = [];
  reset = [];
  gate = null;
  make();
});

test("nothing is handed over before its time, at any speed, and nothing is left out", async () => {
  await player.seek(0);
  await settle(50);
  player.play();
  for (const speed of [1, 4]) {
    player.speed = speed;
    const before = player.atMs;
    await run(2000);
    assert.ok(Math.abs(player.atMs - before - 2000 * speed) <= 200, String(player.atMs));
    assert.ok(handed.every(({ atMs }) => atMs <= player.atMs));
  }
  const states = handed.filter(({ topic }) => topic === "/state").map(({ atMs }) => atMs);
  assert.ok(states.every((atMs, i) => atMs === (i + 1) * 100));
});

test("a seek gives what was the case there: the newest map, and the video from its key frame on", async () => {
  await player.seek(12_340);
  const [{ list, atMs }] = reset;
  const of = (topic) => list.filter((each) => each.topic === topic).map((each) => each.atMs);
  assert.equal(atMs, 12_340);
  assert.deepEqual([of("/map"), of("/static")], [[0], [10]]);
  assert.deepEqual([of("/video")[0], of("/video").at(-1)], [10_000, 12_300]);
  assert.ok(of("/state")[0] > 10_000);
  assert.ok(list.every((each) => each.atMs <= 12_340));
});

test("of many seeks in a row the last counts", async () => {
  await player.seek(0);
  for (let atMs = 1000; atMs <= 9000; atMs += 1000) player.seek(atMs);
  await settle(50);
  assert.equal(reset.at(-1).atMs, 9000);
  assert.ok(reset.length <= 3);
});

test("the clock waits for what is not read yet, and stops at the end", async () => {
  let open = () => {};
  await player.seek(DURATION_MS - 1000);
  gate = new Promise((resolve) => (open = resolve));
  player.seek(DURATION_MS - 900);
  player.play();
  await run(1000);
  assert.deepEqual([player.atMs, player.loading], [DURATION_MS - 900, true]);
  open();
  await settle(50);
  await run(2000);
  assert.deepEqual([player.atMs, player.playing], [DURATION_MS, false]);
});

test("a bomb of messages is read in pieces and holds no more than its bounds", async () => {
  make(Array.from({ length: 50_000 }, (_, i) => message("/state", i / 10)));
  await player.seek(0);
  await settle(50);
  let most = 0;
  player.play();
  for (let i = 0; i < 20; i++) {
    await run(50);
    most = Math.max(most, player.waiting.length);
  }
  assert.ok(most <= 20_001, String(most));
  assert.ok(player.atMs > 0);
});

test("an error is kept for the page, and Play begins anew where it was", async () => {
  player.reader.backwards = () => {
    throw new Error("gone");
  };
  await player.seek(100);
  assert.equal(player.error.message, "gone");
  player.reader = readerOf(MESSAGES);
  player.play();
  await run(1000);
  assert.equal(player.error, null);
  assert.ok(player.atMs > 500 && player.atMs < 1200, String(player.atMs));
});
