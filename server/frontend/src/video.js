// Plays the robot's MJPEG stream and starts it again after a cut. It reads the stream itself instead of
// leaving it to <img src>: an <img> tells neither why there is no picture nor that the stream stalled,
// and browsers keep its connection open after the page has dropped it.

import { backoff } from "./backoff.js";
import { MultipartReader, boundaryOf } from "./multipart.js";
import { picture as texts } from "./texts.js";

const WATCH_MS = 1000;
const OLD_MS = 2000;
const CUT_MS = 6000;

export function streamUrl(robot, { topic, quality, width, height }) {
  const query = new URLSearchParams({ topic, type: "mjpeg", quality });
  if (width && height) {
    query.set("width", width);
    query.set("height", height);
  }
  return `/robots/${encodeURIComponent(robot)}/video/stream?${query}`;
}

export class Video {
  // `onFrame(jpeg)`; `onStatus({picture: "live"|"old"|"none", text})`.
  constructor({ onFrame, onStatus, now = () => performance.now() }) {
    Object.assign(this, { onFrame, onStatus, now });
    this.delays = backoff();
    this.abort = null;
  }

  // Ends what plays and plays this URL, at once.
  play(url) {
    this.pause(texts.starting);
    this.url = url;
    this.delays = backoff();
    this.watch = setInterval(() => this.checkAge(), WATCH_MS);
    this.attempt();
  }

  // For news that the robot may be back: no wait for the next attempt.
  retryNow() {
    if (this.url && !this.abort && this.watch) this.attempt();
  }

  pause(text = texts.paused) {
    clearInterval(this.watch);
    this.watch = undefined;
    this.endAttempt();
    this.tell("none", text);
  }

  async attempt() {
    this.endAttempt();
    const abort = (this.abort = new AbortController());
    this.frameAt = this.now();
    let text;
    try {
      text = await this.stream(abort.signal);
    } catch {
      text = texts.cut;
    }
    if (abort === this.abort) this.fail(text);
  }

  // Reads until the stream ends; gives the sentence that says why there is no picture.
  async stream(signal) {
    const answer = await fetch(this.url, { signal, cache: "no-store" });
    if (!answer.ok) return refusal(answer);
    const boundary = boundaryOf(answer.headers.get("Content-Type"));
    if (boundary === null) return texts.video_down;
    const reader = new MultipartReader(boundary);
    const body = answer.body.getReader();
    for (let read = await body.read(); !read.done; read = await body.read()) {
      for (const frame of reader.push(read.value)) this.frame(frame);
    }
    return texts.cut;
  }

  frame(jpeg) {
    this.frameAt = this.now();
    this.delays = backoff();
    this.onFrame(jpeg);
    this.tell("live", "");
  }

  fail(text) {
    this.endAttempt();
    this.tell("none", text);
    this.timer = setTimeout(() => this.attempt(), this.delays.next().value);
  }

  endAttempt() {
    clearTimeout(this.timer);
    this.abort?.abort();
    this.abort = null;
  }

  checkAge() {
    if (!this.abort) return;
    const age = this.now() - this.frameAt;
    if (age > CUT_MS) this.fail(texts.cut);
    else if (age > OLD_MS && this.told !== "none") this.tell("old", texts.old(Math.round(age / 1000)));
  }

  tell(picture, text) {
    this.told = picture;
    this.onStatus({ picture, text });
  }
}

async function refusal(answer) {
  const { code } = await answer.json().catch(() => ({}));
  return typeof texts[code] === "string" ? texts[code] : texts.refused(answer.status);
}
