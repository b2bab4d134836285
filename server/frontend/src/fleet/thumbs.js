// A robot's snapshot on the fleet page: taken again while it is on the screen, and let go when it is not.

import { readRefusal, snapshotUrl, withTimeLimit } from "../client/api.js";
import { jpegBlob } from "../decoders/jpeg.js";
import { localTime, part, setText } from "../dom/page.js";
import { because } from "../texts/common.js";
import { thumb as texts } from "../texts/fleet.js";

const EVERY_MS = 5000; // interval between snapshots, each some 10 KB of the robot's uplink
const AGAIN_MS = 30_000; // interval after a failure

export class Thumbs {
  constructor() {
    this.queue = new Queue();
    this.byElement = new WeakMap();
    this.seen = new Set();
    this.watcher = new IntersectionObserver((entries) => this.see(entries));
    document.addEventListener("visibilitychange", () => this.turn());
  }

  add(element, robot, mac) {
    const box = part(element, "thumb");
    if (!box) return;
    this.byElement.set(box, new Thumb(box, { robot, mac, card: element, queue: this.queue }));
    this.watcher.observe(box);
  }

  see(entries) {
    for (const { target, isIntersecting } of entries) {
      const thumb = this.byElement.get(target);
      if (isIntersecting) this.seen.add(thumb);
      else this.seen.delete(thumb);
      if (isIntersecting && !document.hidden) thumb.begin();
      else thumb.release();
    }
  }

  // A page that nobody sees costs no robot its uplink.
  turn() {
    for (const thumb of this.seen) {
      if (document.hidden) thumb.release();
      else thumb.begin();
    }
  }
}

export class Thumb {
  // `mac`: of the robot meant, as another one may have its name by now.
  constructor(box, { robot, mac, card, queue }) {
    this.box = box;
    this.robot = robot;
    this.mac = mac;
    this.card = card;
    this.queue = queue;
    this.image = part(box, "thumb-image");
    this.words = part(box, "thumb-words");
  }

  begin() {
    if (this.cancel) return;
    clearTimeout(this.timer);
    // Looked at again: the robot may come online, or its video.
    const lack = lackOf(this.card.dataset);
    if (lack) {
      this.drop();
      this.showState(lack);
      return this.later(EVERY_MS);
    }
    if (this.image.hidden) this.showState("waiting");
    const cancel = this.queue.add(async (signal) => {
      const words = { topic: this.card.dataset.camera || undefined, mac: this.mac };
      const snapshot = await fetchSnapshot(this.robot, words, signal).catch(() => ({ problem: "failed" }));
      if (this.cancel !== cancel) return;
      this.cancel = null;
      this.show(snapshot);
      this.later(snapshot.blob ? EVERY_MS : AGAIN_MS);
    });
    this.cancel = cancel;
    this.timer = setTimeout(() => this.wait(), TIMEOUT_MS);
  }

  // The robots before it may take their time: until its turn has come, the picture of before would look like now.
  wait() {
    this.drop();
    this.showState("waiting");
  }

  later(ms) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.begin(), ms);
  }

  show({ blob, problem, detail }) {
    this.drop();
    if (!blob) return this.showState(problem, detail);
    this.url = URL.createObjectURL(blob);
    this.image.src = this.url;
    this.image.hidden = false;
    this.box.dataset.thumb = "shown";
    setText(this.words, "");
    this.image.alt = texts.taken(this.robot, localTime(new Date().toISOString()));
  }

  showState(state, detail = "") {
    this.box.dataset.thumb = state;
    setText(this.words, detail ? because(detail) : texts[state]);
  }

  drop() {
    if (this.url) URL.revokeObjectURL(this.url);
    this.url = null;
    this.image.hidden = true;
    this.image.removeAttribute("src");
  }

  release() {
    clearTimeout(this.timer);
    this.cancel?.();
    this.cancel = null;
    this.drop();
    this.showState("empty");
  }
}

// Why a robot is not asked for a snapshot; empty for one that is. `video` as of the fleet's events.
export function lackOf({ online, video }) {
  if (online !== "true") return "empty";
  return video === "down" ? "video_down" : "";
}

// Gets snapshots of robots' cameras, few at once: each costs its robot's uplink.
const MAX_JOBS = 4;
const TIMEOUT_MS = 10_000;
const SIZE = { width: 320, height: 240, quality: 50 };

// Runs a bounded number of jobs at once, in the order in which they came. Pure.
export class Queue {
  constructor(most = MAX_JOBS) {
    this.most = most;
    this.running = 0;
    this.waiting = [];
  }

  // `job(signal)` gives a promise; gives the function that ends the job or keeps it from beginning.
  add(job) {
    const abort = new AbortController();
    const entry = { job, abort };
    this.waiting.push(entry);
    this.next();
    return () => {
      this.waiting = this.waiting.filter((other) => other !== entry);
      abort.abort();
    };
  }

  async next() {
    if (this.running >= this.most || this.waiting.length === 0) return;
    const { job, abort } = this.waiting.shift();
    this.running += 1;
    await withTimeLimit(TIMEOUT_MS, job, abort).catch(() => {});
    this.running -= 1;
    this.next();
  }
}

// Gives {blob} or {problem, detail}: a problem of texts/fleet.js, and what the robot says of it. Without `topic` among `words` the
// robot's first camera is shown, which its agent chooses.
/** @returns {Promise<any>} */
export async function fetchSnapshot(robot, words, signal) {
  const answer = await fetch(snapshotUrl(robot, { ...words, ...SIZE }), { signal, cache: "no-store" });
  if (answer.ok) return { blob: jpegBlob(new Uint8Array(await answer.arrayBuffer())) };
  const { code, detail } = await readRefusal(answer);
  return { problem: PROBLEMS[code] ?? "failed", detail };
}

const PROBLEMS = { robot_offline: "offline", video_down: "video_down" };
