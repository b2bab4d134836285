// Asks the server's API to do something, with the login of this page, and keeps that login while somebody uses the page.

import { Api, csrfToken } from "../client/api.js";

export const api = new Api({ headers: () => ({ "X-CSRFToken": csrfToken() }), onDate: (date) => serverClock.receive(date) });

// All that this user manages, or those of a site.
export const stopAll = (site) => api.post("/api/v1/stop", site ? { site } : {}, { keepalive: true });

// The server's time of day, for countdowns and ends: this machine's own may be minutes off. Pure.
const HALF_SECOND_MS = 500; // the header Date has whole seconds, cut off

export class ServerClock {
  constructor(now = () => Date.now()) {
    this.now = now;
    this.aheadMs = 0;
  }

  // `date` is the header Date of an answer that has just come.
  receive(date) {
    const time = Date.parse(date ?? "");
    if (Number.isFinite(time)) this.aheadMs = time + HALF_SECOND_MS - this.now();
  }

  get nowMs() {
    return this.now() + this.aheadMs;
  }

  // Whole seconds until a time of day as the server writes it; never less than 0.
  secondsUntil(iso) {
    const left = Date.parse(iso) - this.nowMs;
    return Math.max(0, Math.ceil(left / 1000)) || 0;
  }
}

export const serverClock = new ServerClock();

// Counts what a person does on a page as use of the login, which else ends after LOGIN_IDLE_H and takes the page's
// connections along: driving asks nothing of the web. A page that nobody touches must not keep the login.
const EVERY_MS = 5 * 60_000; // least interval between two reports of use
const EVENTS = ["pointerdown", "keydown", "wheel"];

export class LoginUse {
  // The page itself was such a use when it was loaded.
  constructor({ ask = () => fetch("/api/v1/me"), now = () => performance.now() } = {}) {
    this.ask = ask;
    this.now = now;
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
