// A question that comes up by itself, over the picture. It is deaf while it is new and while somebody drives: what is
// pressed then was meant for what stood there before, or slipped off the stick.

const NEW_MS = 700;
const CHECK_MS = 100;

export class Question {
  // `busy()` says whether a key or stick is held.
  constructor(element, { busy = () => false, now = () => performance.now() } = {}) {
    Object.assign(this, { element, busy, now });
    this.shownAt = -Infinity;
    element.addEventListener("click", (event) => this.sift(event), { capture: true });
    setInterval(() => this.mark(), CHECK_MS);
  }

  get shown() {
    return !this.element.hidden;
  }

  get deaf() {
    return this.now() - this.shownAt < NEW_MS || this.busy();
  }

  show(shown) {
    if (shown === this.shown) return;
    if (shown) this.shownAt = this.now();
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
