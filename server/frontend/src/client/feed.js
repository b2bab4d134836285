// The fleet's live events (/api/v1/events of docs/reference/protocols.md), with a state that the page can show.
// It reads the stream itself: EventSource hides the comments that tell a quiet stream from a dead one,
// gives up for good after an HTTP error, and does not tell an ended login from a server that is down.

import { backoff } from "./api.js";

const SILENCE_MS = 7000; // time limit for silence of the relay: over two of its comments
const CHECK_MS = 1000;

export class Feed {
  // `onState("connecting"|"live"|"lost"|"login")`; the other handlers get what the events carry.
  /**
   * @param {{
   *   onFleet?: (all: any[]) => void,
   *   onRobot: (robot: any) => void,
   *   onRemoved?: (robot: {name: string}) => void,
   *   onState?: (state: "connecting" | "live" | "lost" | "login") => void,
   * }} handlers
   */
  constructor({ onFleet = () => {}, onRobot, onRemoved = () => {}, onState = () => {} }) {
    this.handlers = { fleet: onFleet, robot: onRobot, removed: onRemoved };
    this.onState = onState;
    this.delays = backoff();
    this.abort = null;
    this.heardAt = NaN;
  }

  start() {
    this.onState("connecting");
    this.open();
    window.addEventListener("online", () => this.open());
  }

  async open() {
    this.close();
    const abort = (this.abort = new AbortController());
    this.heardAt = Date.now();
    this.watch = setInterval(() => this.checkSilence(), CHECK_MS);
    const request = { headers: { Accept: "text/event-stream" }, signal: abort.signal, cache: /** @type {RequestCache} */ ("no-store") };
    const answer = await fetch("/api/v1/events", request).catch(() => null);
    if (answer?.body && answer.ok) await this.listen(answer.body.getReader());
    if (abort !== this.abort) return;
    if (answer?.status === 401) this.endLogin();
    else this.lose();
  }

  // Until the stream ends or is cut.
  async listen(body) {
    const reader = new EventReader();
    for (let bytes = await next(body); bytes; bytes = await next(body)) {
      this.heardAt = Date.now();
      for (const event of reader.push(bytes)) this.receive(event);
    }
  }

  receive({ name, data }) {
    this.delays = backoff();
    this.onState("live");
    this.handlers[name]?.(JSON.parse(data));
  }

  // A network that goes away silently ends nothing. By the time of day: a timer may stand still in a sleep of the machine.
  checkSilence() {
    if (Math.abs(Date.now() - this.heardAt) >= SILENCE_MS) this.lose();
  }

  lose() {
    this.close();
    this.onState("lost");
    this.timer = setTimeout(() => this.open(), this.delays.next().value);
  }

  endLogin() {
    this.close();
    this.onState("login");
  }

  close() {
    clearTimeout(this.timer);
    clearInterval(this.watch);
    this.abort?.abort();
    this.abort = null;
  }
}

// Gives null at the end.
async function next(body) {
  const { done, value } = await body.read().catch(() => ({ done: true }));
  return done ? null : value;
}

// Takes the events out of a text/event-stream body as its bytes arrive. Pure.
// Of the format only what our relay writes: `event`, `data` and comments, each line ended by one "\n".
export class EventReader {
  constructor() {
    this.decoder = new TextDecoder();
    this.rest = "";
  }

  // Gives the events {name, data} that these bytes complete; a comment completes none.
  push(bytes) {
    const blocks = (this.rest + this.decoder.decode(bytes, { stream: true })).split("\n\n");
    this.rest = blocks.pop() ?? "";
    return blocks.map(parseEvent).filter(({ data }) => data);
  }
}

function parseEvent(block) {
  const lines = block.split("\n");
  const values = (field) => lines.filter((line) => line.startsWith(`${field}: `)).map((line) => line.slice(field.length + 2));
  return { name: values("event")[0], data: values("data").join("\n") };
}
