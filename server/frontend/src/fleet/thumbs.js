// A robot's small picture on the fleet page: comes when somebody presses, points at or focuses it, and is let go when it
// leaves the screen.

import { localTime, part, setText } from "../pages/page.js";
import { thumb as texts } from "../texts/fleet.js";

const INTENT_MS = 300;
const FRESH_MS = 5000;

export class Thumbs {
  // `queue` and `snapshots` as of snapshots.js.
  constructor({ queue, snapshots, now = () => performance.now() }) {
    Object.assign(this, { queue, snapshots, now });
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
    Object.assign(this, { button, robot, topic, thumbs });
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

  // Who only passes over it wants no picture.
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
