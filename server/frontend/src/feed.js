// The fleet's live events (/api/v1/events of docs/protocols.md), with a state that the page can show.

import { backoff } from "./backoff.js";

export class Feed {
  // `onState("connecting"|"live"|"lost"|"login")`; the other handlers get what the events carry.
  constructor({ onFleet = () => {}, onRobot, onRemoved = () => {}, onState = () => {} }) {
    this.handlers = { fleet: onFleet, robot: onRobot, removed: onRemoved };
    this.onState = onState;
    this.delays = backoff();
  }

  start() {
    this.onState("connecting");
    this.open();
    window.addEventListener("online", () => this.open());
  }

  open() {
    clearTimeout(this.timer);
    this.source?.close();
    this.source = new EventSource("/api/v1/events");
    for (const [name, handle] of Object.entries(this.handlers)) {
      this.source.addEventListener(name, ({ data }) => this.heard(handle, data));
    }
    this.source.onerror = () => this.lost();
  }

  heard(handle, data) {
    this.delays = backoff();
    this.onState("live");
    handle(JSON.parse(data));
  }

  // A browser gives up for good after an HTTP error such as 502, so the page opens the next one itself.
  async lost() {
    this.source.close();
    this.onState("lost");
    this.timer = setTimeout(() => this.open(), this.delays.next().value);
    if (await loginEnded()) this.end();
  }

  end() {
    clearTimeout(this.timer);
    this.source.close();
    this.onState("login");
  }
}

// EventSource does not tell an ended login from a server that is down; the API does.
async function loginEnded() {
  const answer = await fetch("/api/v1/robots", { cache: "no-store" }).catch(() => null);
  return answer?.status === 401;
}
