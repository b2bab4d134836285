// Counts what a person does on a page as use of the login, which else ends after LOGIN_IDLE_H and takes the page's
// connections along: driving asks nothing of the web. A page that nobody touches must not keep the login.

const EVERY_MS = 5 * 60_000;
const EVENTS = ["pointerdown", "keydown", "wheel"];

export class LoginUse {
  // The page itself was such a use when it was loaded.
  constructor({ ask = () => fetch("/api/v1/me"), now = () => performance.now() } = {}) {
    Object.assign(this, { ask, now });
    this.askedAt = now();
  }

  watch(target) {
    for (const name of EVENTS) target.addEventListener(name, () => this.note(), { passive: true, capture: true });
  }

  note() {
    if (this.now() - this.askedAt < EVERY_MS) return;
    this.askedAt = this.now();
    this.ask().catch(() => {}); // a cut network: the next use asks again
  }
}
