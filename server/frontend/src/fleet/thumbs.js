// A robot's small picture on the fleet page: comes when somebody presses, points at or focuses it, and is let go when it
// leaves the screen.

import { plainQuery } from "../client/api.js";
import { localTime, part, setText } from "../pages/page.js";
import { thumb as texts } from "../texts/fleet.js";

const INTENT_MS = 300;
const FRESH_MS = 5000;

export class Thumbs {
  // `queue` and `snapshots` are a Queue and Snapshots.
  constructor({ queue, snapshots, now = () => performance.now() }) {
    this.queue = queue;
    this.snapshots = snapshots;
    this.now = now;
    this.byElement = new WeakMap();
    this.watcher = new IntersectionObserver((entries) => this.see(entries));
  }

  add(element, robot) {
    const button = part(element, "thumb");
    if (button) this.byElement.set(button, new Thumb(button, { robot, topic: element.dataset.camera ?? "", thumbs: this }));
  }

  see(entries) {
    for (const { target, isIntersecting } of entries) {
      if (!isIntersecting) this.byElement.get(target)?.release();
    }
  }
}

class Thumb {
  constructor(button, { robot, topic, thumbs }) {
    this.button = button;
    this.robot = robot;
    this.topic = topic;
    this.thumbs = thumbs;
    this.image = part(button, "thumb-image");
    this.words = part(button, "thumb-words");
    this.takenAt = -Infinity;
    button.setAttribute("aria-label", texts.label(robot));
    const on = (name, act) => button.addEventListener(name, act);
    on("click", () => this.load());
    on("pointerenter", ({ pointerType }) => pointerType !== "touch" && this.intend());
    on("focus", () => this.intend());
    on("pointerleave", () => clearTimeout(this.timer));
    on("blur", () => clearTimeout(this.timer));
  }

  // No picture is loaded for a pointer that only passes over it.
  intend() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.load(), INTENT_MS);
  }

  load() {
    clearTimeout(this.timer);
    const { thumbs } = this;
    if (this.cancel || thumbs.now() - this.takenAt < FRESH_MS) return;
    thumbs.watcher.observe(this.button);
    this.showState("waiting");
    const cancel = thumbs.queue.add(async (signal) => {
      const found = await thumbs.snapshots.fetchImage(this.robot, this.topic, signal).catch(() => ({ problem: "failed" }));
      if (this.cancel !== cancel) return;
      this.cancel = null;
      this.show(found);
    });
    this.cancel = cancel;
  }

  show({ blob, problem }) {
    if (!blob) {
      this.drop();
      return this.showState(problem);
    }
    this.drop();
    this.takenAt = this.thumbs.now();
    this.url = URL.createObjectURL(blob);
    this.image.src = this.url;
    this.image.hidden = false;
    this.button.dataset.thumb = "shown";
    setText(this.words, "");
    this.button.setAttribute("aria-label", texts.taken(this.robot, localTime(new Date().toISOString())));
  }

  showState(words) {
    this.button.dataset.thumb = words;
    setText(this.words, texts[words]);
  }

  drop() {
    if (this.url) URL.revokeObjectURL(this.url);
    this.url = null;
    this.image.hidden = true;
    this.image.removeAttribute("src");
    this.takenAt = -Infinity;
  }

  release() {
    this.thumbs.watcher.unobserve(this.button);
    this.cancel?.();
    this.cancel = null;
    this.drop();
    this.showState("empty");
    this.button.setAttribute("aria-label", texts.label(this.robot));
  }
}

// Gets single pictures of robots' cameras, few at once: each costs its robot's uplink.
const AT_ONCE = 4;
const PATIENCE_MS = 8000;
const SIZE = { width: 320, height: 240, quality: 50 };

// Runs at most so many jobs at once, in the order in which they came. Pure.
export class Queue {
  constructor(most = AT_ONCE) {
    this.most = most;
    this.running = 0;
    this.waiting = [];
  }

  // `job(signal)` gives a promise; the function that is given ends the job or keeps it from beginning.
  add(job) {
    const abort = new AbortController();
    const entry = { job, signal: abort.signal };
    this.waiting.push(entry);
    this.next();
    return () => {
      this.waiting = this.waiting.filter((other) => other !== entry);
      abort.abort();
    };
  }

  async next() {
    if (this.running >= this.most || this.waiting.length === 0) return;
    const { job, signal } = this.waiting.shift();
    this.running += 1;
    await job(signal).catch(() => {});
    this.running -= 1;
    this.next();
  }
}

const videoPath = (robot) => `/robots/${encodeURIComponent(robot)}/video`;

// The first camera that web_video_server's own page names; "" for none. Pure.
export function firstTopic(page) {
  const match = /\/snapshot\?topic=([^"'&<> ]+)/.exec(page);
  return match ? decodeURIComponent(match[1]) : "";
}

export class Snapshots {
  // `fetch` as the browser's.
  constructor({ fetch = (url, options) => globalThis.fetch(url, options) } = {}) {
    this.fetch = fetch;
    this.topics = new Map();
  }

  // Gives {blob} or {problem: "offline"|"no_camera"|"video_down"|"failed"}. `topic` "" is not known: the robot is asked.
  async fetchImage(robot, topic, signal) {
    const found = topic ? { topic } : await this.find(robot, signal);
    if (!found.topic) return found;
    const query = plainQuery({ topic: found.topic, ...SIZE });
    const answer = await this.ask(`${videoPath(robot)}/snapshot?${query}`, signal);
    if (!answer.ok) return { problem: problemOf(answer.status) };
    return { blob: await answer.blob() };
  }

  async find(robot, signal) {
    if (this.topics.has(robot)) return { topic: this.topics.get(robot) };
    const answer = await this.ask(`${videoPath(robot)}/`, signal);
    if (!answer.ok) return { problem: problemOf(answer.status) };
    const topic = firstTopic(await answer.text());
    if (!topic) return { problem: "no_camera" };
    this.topics.set(robot, topic);
    return { topic };
  }

  ask(url, signal) {
    return this.fetch(url, { signal: signalWithin(signal, PATIENCE_MS), cache: "no-store" });
  }
}

function problemOf(status) {
  if (status === 503) return "offline";
  return status === 502 ? "video_down" : "failed";
}

// AbortSignal.any is younger than the browsers that the pages are for.
function signalWithin(signal, ms) {
  const abort = new AbortController();
  const timer = setTimeout(() => abort.abort(), ms);
  const end = () => {
    clearTimeout(timer);
    abort.abort();
  };
  if (signal.aborted) end();
  else signal.addEventListener("abort", end, { once: true });
  return abort.signal;
}
