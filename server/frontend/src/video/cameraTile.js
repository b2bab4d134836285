// One camera in its place: a stream of pictures, how old they are, and what is said when there is none.

import { part, setText } from "../pages/page.js";
import { frame as texts } from "../texts/video.js";
import { Painter } from "./painter.js";
import { Rate } from "./rate.js";
import { requestedSize } from "./streamRequest.js";

export class CameraTile {
  // `camera` {topic, name}; `openFrames(topic, {want, onFrame, onStatus})` gives a stream as of client/frames.js; `wanted()` the
  // part of `want` that is the same for all cameras; `set` the settings' {width, height}. `oldMs`: from when a picture is grey.
  constructor(element, { camera, openFrames, wanted, set, oldMs, onPainted, now, painter = new Painter(part(element, "picture")) }) {
    Object.assign(this, { element, camera, openFrames, wanted, set, oldMs, onPainted, now, painter });
    this.rate = new Rate();
    this.at = null; // of the picture that is seen
    this.full = null; // the greatest size that the camera has shown
    this.status = { why: "starting" };
    this.turned = 0;
    this.asked = "";
    element.dataset.topic = camera.topic;
    part(element, "picture").setAttribute("aria-label", texts.of(camera.name));
    this.showState();
  }

  start() {
    if (this.stream) return;
    const want = this.want();
    this.asked = JSON.stringify(want);
    this.stream = this.openFrames(this.camera.topic, {
      want,
      onFrame: (frame) => this.paint(frame),
      onStatus: (status) => this.receiveStatus(status),
    });
    this.stream.start();
  }

  // No picture comes any more; the last stays, as old as it gets.
  stop(why = "paused") {
    const { stream } = this;
    this.stream = null;
    stream?.stop();
    this.receiveStatus({ why });
  }

  retryNow() {
    this.stream?.retryNow();
  }

  // The picture may be older than its moment says.
  forget() {
    this.at = null;
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

  want() {
    return { ...this.wanted(), ...requestedSize({ full: this.full, set: this.set, box: this.box(), turned: this.turned }) };
  }

  box() {
    const { clientWidth, clientHeight } = this.element;
    const ratio = globalThis.devicePixelRatio || 1;
    return { width: clientWidth * ratio, height: clientHeight * ratio };
  }

  // Asks for what is wanted now, if that is something else.
  ask() {
    const want = this.want();
    const asked = JSON.stringify(want);
    if (asked === this.asked) return;
    this.asked = asked;
    this.stream?.want(want);
  }

  // Only what is seen counts: the moment is kept when the picture stands on the page.
  async paint({ jpeg, at }) {
    const { stream } = this;
    const size = await this.painter.show(jpeg);
    if (stream !== this.stream || !stream) return;
    this.at = at;
    this.rate.hit(this.now());
    this.learn(size);
    if (this.element.dataset.picture !== this.state) this.showState();
    this.onPainted(this.camera.topic);
  }

  // A smaller picture than before may be one that was asked for.
  learn(size) {
    this.size = size;
    if (this.full && this.full.width >= size.width) return;
    this.full = size;
    this.ask();
  }

  receiveStatus(status) {
    this.status = status;
    this.showState();
  }

  get ageMs() {
    return this.at === null ? null : Math.max(0, this.now() - this.at);
  }

  get state() {
    if (this.ageMs === null) return "none";
    return this.ageMs > this.oldMs ? "old" : "live";
  }

  // Called a few times a second: numbers that change with each picture cost a layout each, and nobody can read them.
  showState() {
    const { state } = this;
    this.element.dataset.picture = state;
    setText(part(this.element, "words"), state === "live" ? "" : this.words(state));
    setText(part(this.element, "facts"), this.facts(state));
  }

  words(state) {
    const { why, detail } = this.status;
    const reason = texts.why[why]?.(detail ?? "") ?? "";
    if (state === "old") return reason ? `${texts.old} ${reason}` : texts.old;
    return reason || texts.why.waiting();
  }

  // A small picture has room for its age alone.
  facts(state) {
    if (state === "none") return "";
    const age = texts.age(this.ageMs);
    return this.element.dataset.main === "true" ? [age, ...this.details()].join(" · ") : age;
  }

  details() {
    const rate = this.rate.perSecond(this.now());
    const { quality } = this.status;
    return [rate === null ? "" : texts.rate(rate), quality ? texts.quality(quality) : "", texts.size(this.size)].filter(Boolean);
  }
}
