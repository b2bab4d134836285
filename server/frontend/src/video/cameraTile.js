// One camera in its place: its stream, the age of its frames, and a text when there are none.

import { Painter } from "../client/painter.js";
import { ShownFrames } from "../client/shownFrames.js";
import { FrameDecoder } from "../decoders/frameDecoder.js";
import { KeyFrameMissingError } from "../decoders/streamDecoder.js";
import { part, setText } from "../dom/page.js";
import { frame as texts } from "../texts/video.js";

const SENDS = ["waiting", "old"]; // what is said of no new frame while the camera sends some

export class CameraTile {
  // `camera` {topic, name}; `openFrames(topic, {request, onFrame, onStatus})` gives a stream as of client/frames.js; `common()` the
  // part of `request` that is the same for all cameras; `set` the settings' {width, height}. `oldMs`: from when a frame is grey.
  // `onDown(topic)`: its source gives no frames. `choice` is a DecoderChoice.
  constructor(element, options) {
    const { camera, openFrames, common, set, oldMs, onPainted, onDown, now, choice } = options;
    this.element = element;
    this.camera = camera;
    this.openFrames = openFrames;
    this.common = common;
    this.set = set;
    this.oldMs = oldMs;
    this.onPainted = onPainted;
    this.onDown = onDown;
    this.now = now;
    this.choice = choice;
    this.painter = options.painter ?? new Painter(part(element, "canvas"));
    this.decoder = options.decoder ?? this.makeDecoder();
    this.rate = new FrameRate();
    this.at = null; // of the frame that is seen
    this.shownFrames = new ShownFrames({ now });
    this.codec = null; // of the frame that is seen
    this.full = null; // the greatest size that the camera has shown
    this.status = { why: "starting" };
    this.isUndecodable = false; // whether the newest frame could not be decoded
    this.turned = 0;
    this.request = "";
    element.dataset.topic = camera.topic;
    part(element, "canvas").setAttribute("aria-label", texts.of(camera.name));
    this.showState();
    choice.ready.then(() => this.ask());
  }

  makeDecoder() {
    return new FrameDecoder({
      choice: this.choice,
      onKeyFrame: () => this.stream?.requestKeyFrame(),
      onCodecs: () => this.ask(),
    });
  }

  start() {
    if (this.stream) return;
    const request = this.streamRequest();
    this.asked = JSON.stringify(request);
    this.stream = this.openFrames(this.camera.topic, {
      request,
      onFrame: (frame) => this.paint(frame),
      onGap: () => this.decoder.close(),
      onStatus: (status) => this.receiveStatus(status),
    });
    this.stream.start();
  }

  // No frame comes any more; the last stays, as old as it gets.
  stop(why = "paused") {
    const { stream } = this;
    this.stream = null;
    stream?.stop();
    this.receiveStatus({ why });
  }

  retryNow() {
    this.stream?.retryNow();
  }

  // The frame may be older than its timestamp says.
  forget() {
    this.at = null;
    this.shownFrames.forget();
    this.showState();
  }

  close() {
    this.stop();
    this.element.remove();
  }

  turn(degrees) {
    this.turned = degrees;
    this.painter.turned = degrees;
    this.ask();
  }

  streamRequest() {
    const { choice, full, set, turned } = this;
    return { ...this.common(), codecs: choice.codecs, ...requestedSize({ full, set, box: this.box(), turned }) };
  }

  box() {
    const { clientWidth, clientHeight } = this.element;
    const ratio = globalThis.devicePixelRatio || 1;
    return { width: clientWidth * ratio, height: clientHeight * ratio };
  }

  // Asks for what is wanted now, if that is something else.
  ask() {
    const request = this.streamRequest();
    const text = JSON.stringify(request);
    if (text === this.asked) return;
    this.asked = text;
    this.stream?.ask(request);
  }

  // Only what is seen counts: the timestamp is kept when the frame is on the page.
  async paint(frame) {
    const { stream } = this;
    const image = await this.decoder.decode(frame).catch((error) => {
      this.isUndecodable = !(error instanceof KeyFrameMissingError);
      throw error;
    });
    this.isUndecodable = false;
    if (stream === this.stream && stream) this.show(image, frame);
    else image.close();
  }

  show(image, { codec, at, sequence }) {
    const size = this.painter.show(image);
    this.codec = codec;
    this.at = at;
    this.shownFrames.draw({ sequence, at });
    this.rate.hit(this.now());
    this.learn(size);
    if (this.element.dataset.frame !== this.state) this.showState();
    this.onPainted(this.camera.topic);
  }

  // A smaller frame than before may be one that was asked for.
  learn(size) {
    this.size = size;
    if (this.full && this.full.width >= size.width) return;
    this.full = size;
    this.ask();
  }

  receiveStatus(status) {
    this.status = status;
    this.showState();
    if (status.why === "down") this.onDown(this.camera.topic);
  }

  get ageMs() {
    return this.at === null ? null : Math.max(0, this.now() - this.at);
  }

  get state() {
    if (this.ageMs === null) return "none";
    return this.ageMs > this.oldMs ? "old" : "live";
  }

  // Called a few times a second: numbers that change with each frame cost a layout each, and nobody can read them.
  showState() {
    const { state } = this;
    this.element.dataset.frame = state;
    setText(part(this.element, "words"), state === "live" ? "" : this.words(state));
    setText(part(this.element, "facts"), this.facts(state));
  }

  get why() {
    const { why } = this.status;
    return this.isUndecodable && SENDS.includes(why) ? "undecodable" : why;
  }

  words(state) {
    const { why } = this;
    const { detail } = this.status;
    const reason = texts.why[why]?.(detail ?? "") ?? "";
    if (state === "old") return reason ? `${texts.old} ${reason}` : texts.old;
    return reason || texts.why.waiting();
  }

  // A small tile has room for its age alone; that of the main one is among the page's numbers.
  facts(state) {
    if (state === "none") return "";
    return this.element.dataset.main === "true" ? this.details().join(" · ") : texts.age(this.ageMs);
  }

  details() {
    const rate = this.rate.perSecond(this.now());
    const { quality } = this.status;
    const parts = [texts.codec(this.codec), rate !== null && texts.rate(rate), quality && texts.quality(quality), texts.size(this.size)];
    return parts.filter(Boolean);
  }

  // How its frames are encoded, and why they are no better encoded; empty while there are none.
  get encoding() {
    if (this.state === "none") return "";
    const { encoder, no_encoder: reason } = this.status;
    return texts.encoding({ codec: this.codec, encoder, reason, isOnly: this.choice.codecs.length === 1 });
  }
}

// Frames a second, over the last two seconds. Pure.
const SPAN_MS = 2000;

export class FrameRate {
  constructor() {
    this.timestamps = [];
  }

  hit(now) {
    this.timestamps = [...this.fresh(now), now];
  }

  // One decimal; null before there are two to get a rate from.
  perSecond(now) {
    const timestamps = this.fresh(now);
    if (timestamps.length < 2) return timestamps.length ? null : 0;
    const span = Math.max(now, timestamps.at(-1)) - timestamps[0];
    return Math.round(((timestamps.length - 1) * 10_000) / span) / 10;
  }

  fresh(now) {
    return this.timestamps.filter((timestamp) => now - timestamp <= SPAN_MS);
  }
}

// What is wanted of a camera (docs/reference/media.md, `stream_request`), by the person's choice, the robot's settings and the room on
// the page. Pure.
// Automatic, the settings' range by what the person prefers, or one of the steps that the paper drove with, and one below.
const PREFERENCES = ["smooth", "sharp"];
const QUALITIES = ["90", "70", "50", "30"];

// A small frame is asked for in few sizes: each change is a new request at the camera.
const PARTS = [0.25, 0.5];
const ENOUGH = 0.9; // of the pixels that the page has

export function requestedQuality(choice, { quality_min = 20, quality_max = 80 } = {}) {
  if (PREFERENCES.includes(choice)) return { quality_min, quality_max, prefers: choice };
  if (!QUALITIES.includes(choice)) return { quality_min, quality_max };
  return { quality_min: Number(choice), quality_max: Number(choice) };
}

// `full`: the camera's own size as far as it is known, or null. `set`: the settings' {width, height}, or nulls.
// `box`: the place on the page in device pixels. Gives {width, height}, null for the camera's own.
export function requestedSize({ full, set, box, turned }) {
  const whole = set.width ? set : OWN;
  const size = set.width ? set : full;
  const part = size && box.width && box.height ? partOf(size, across(box, turned)) : 1;
  return part === 1 ? whole : { width: even(size.width * part), height: even(size.height * part) };
}

const OWN = { width: null, height: null };

// The box as the camera sees it.
const across = (box, turned) => (turned % 180 ? { width: box.height, height: box.width } : box);

function partOf(size, box) {
  const needed = Math.min(box.width / size.width, box.height / size.height) * ENOUGH;
  return PARTS.find((part) => part >= needed) ?? 1;
}

const MAX_SIDE = 4096; // of a request, in which the camera keeps its shape
const even = (pixels) => Math.min(MAX_SIDE, Math.max(2, Math.round(pixels / 2) * 2));
