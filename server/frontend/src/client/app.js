// A page as a web app: an end of its user's routes (docs/howto/routes.md). It reaches no robot but by them.

import { Api, appTicket, appUrl, credentials, ticketBy } from "./api.js";
import { CLOSED, Connection, whenLive } from "./connection.js";
import { fullName, openLink } from "./rosbridge.js";
import { ClockSync } from "./session.js";

const NAME = /^[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?$/;
const MAX_SILENCE_MS = 3000; // of the server, which answers each second

export class App {
  // `name` is that in routes. `server`, `token` and `getTicket({app})` as of a Robot.
  /** @param {{name: string, server?: string, token?: string | null, getTicket?: ((wish: {app: string}) => any) | null}} options */
  constructor({ name, server = location.origin, token = null, getTicket = null }) {
    if (!NAME.test(name)) throw new TypeError(`cannot connect app ${name}: its name must be a-z, 0-9 and -`);
    this.name = name;
    this.getTicket = getTicket;
    this.api = new Api({ server, headers: credentials(token) });
    this.handlers = new Set();
    this.publishers = new Map();
    this.clockSync = new ClockSync();
    this.connection = new Connection({
      requestTicket: async () => appUrl(server, name, await this.ticket()),
      openLink,
      onState: (state) => this.notifyState(state),
      maxSilenceMs: MAX_SILENCE_MS,
      onLink: (send) => (send ? this.clockSync.start(send) : this.clockSync.stop()),
      onOwn: () => (this.connection.receivedAt = performance.now()),
    });
    /** @type {AbortController | null} */
    this.listening = null;
  }

  // Resolves when it is connected, and rejects when it never will be. It connects again by itself after each cut.
  connect() {
    const settled = whenLive(this, `app ${this.name}`);
    if (this.listening) this.connection.reopen();
    else this.begin();
    return settled;
  }

  begin() {
    this.listening = new AbortController();
    const { signal } = this.listening;
    window.addEventListener("offline", () => this.connection.cut(), { signal });
    window.addEventListener("online", () => this.connection.retryNow(), { signal });
    this.connection.start();
  }

  close() {
    this.connection.stop();
    this.listening?.abort();
    this.listening = null;
    this.notifyState(CLOSED);
  }

  notifyState(state) {
    [...this.handlers].forEach((handler) => handler(state));
  }

  // "state" with {name, reason} at each change of the connection. Gives the function that ends it.
  on(event, handler) {
    if (event !== "state") throw new TypeError(`cannot report ${event}: an app has only "state"`);
    this.handlers.add(handler);
    return () => this.handlers.delete(handler);
  }

  // Offers a topic: routes of its user can begin there. `onRefused(why)` for each message that the server refuses.
  advertise(topic, type, /** @type {{onRefused?: (why: string) => void}} */ { onRefused } = {}) {
    const name = fullName(topic);
    if (!this.publishers.has(name)) this.publishers.set(name, this.connection.advertise({ name, type, onRefused }));
  }

  // Gives whether it went to the server, which passes it on if a route begins there.
  publish(topic, type, message) {
    this.advertise(topic, type);
    return this.publishers.get(fullName(topic)).publish(message);
  }

  // Takes what routes of its user bring. Gives the function that ends it; it outlives cuts.
  subscribe(topic, type, handler) {
    return this.connection.subscribe({ name: fullName(topic), type }, handler);
  }

  ticket() {
    return this.getTicket ? ticketBy(this.getTicket, { app: this.name }) : appTicket(this.api, this.name);
  }
}
