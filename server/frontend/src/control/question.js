// A question that comes up by itself, over the video. It accepts no input while it is new and while somebody drives: what is
// pressed then was meant for what stood there before, or slipped off the stick.

const NEW_MS = 700;
const CHECK_MS = 100;

// Whether a press comes too soon to be meant for what is shown now.
export class Deafness {
  constructor(now) {
    this.now = now;
    this.since = -Infinity;
  }

  // Something else is shown from now on.
  renew() {
    this.since = this.now();
  }

  get active() {
    return this.now() - this.since < NEW_MS;
  }
}

export class Question {
  // `busy()` says whether a key or stick is held.
  constructor(element, { busy = () => false, now = () => performance.now() } = {}) {
    this.element = element;
    this.busy = busy;
    this.deafness = new Deafness(now);
    element.addEventListener("click", (event) => this.sift(event), { capture: true });
    setInterval(() => this.mark(), CHECK_MS);
  }

  get shown() {
    return !this.element.hidden;
  }

  get deaf() {
    return this.deafness.active || this.busy();
  }

  show(shown) {
    if (shown === this.shown) return;
    if (shown) this.deafness.renew();
    this.element.hidden = !shown;
    this.mark();
  }

  sift(event) {
    if (!this.deaf) return;
    event.preventDefault();
    event.stopPropagation();
  }

  mark() {
    const deaf = String(this.shown && this.deaf);
    if (this.element.dataset.deaf !== deaf) this.element.dataset.deaf = deaf;
  }
}
