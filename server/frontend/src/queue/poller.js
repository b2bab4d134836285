// Asks the server again and again, and knows how old what it answered is. Pure except for the clock, which the page gives.

const LATE_MS = 4000; // time limit for an answer; then it counts as none, and the server is asked anew
const TICK_MS = 1000;
const HALF_TICK_MS = TICK_MS / 2; // no timer is exact

export class Poller {
  // `ask()` gives an answer as of client/api.js, `onAnswer(body)` gets what is known now. `onState({name, since, detail})` gets
  // each change of what is known of the server: "connecting", "live", "lost" or "login"; `since`: the last answer, as a Date.
  /**
   * @param {{
   *   ask: () => Promise<any>,
   *   onAnswer: (body: any) => void,
   *   onState?: (state: {name: string, since: Date | null, detail: string}) => void,
   *   everyMs?: number,
   *   now?: () => number,
   * }} options
   */
  constructor({ ask, onAnswer, onState = () => {}, everyMs = TICK_MS, now = () => Date.now() }) {
    this.ask = ask;
    this.onAnswer = onAnswer;
    this.onState = onState;
    this.everyMs = everyMs;
    this.now = now;
    this.state = "connecting";
    this.round = 0;
    this.askedAt = -Infinity;
    this.isAsking = false;
    /** @type {Date | null} */
    this.answeredAt = null;
  }

  get isLive() {
    return this.state === "live";
  }

  // As often as the page's clock ticks.
  tick() {
    if (this.state === "login") return;
    const askedFor = this.elapsedMs(this.askedAt);
    const isLate = this.isAsking && askedFor >= LATE_MS;
    if (isLate || this.isOld) this.setState("lost");
    if (isLate || (!this.isAsking && askedFor >= this.everyMs - HALF_TICK_MS)) this.askNow();
  }

  // Also of a page that was hidden or asleep, and asked nothing.
  get isOld() {
    return this.answeredAt !== null && this.elapsedMs(this.answeredAt.getTime()) >= this.everyMs + LATE_MS;
  }

  // The clock may be set back, and then nobody knows how long ago it was.
  elapsedMs(at) {
    return Math.abs(this.now() - at);
  }

  // What was asked before and has not come yet counts no more: it may be from before a person's press.
  async askNow() {
    const round = ++this.round;
    this.askedAt = this.now();
    this.isAsking = true;
    const answer = await this.ask();
    if (round !== this.round) return;
    this.isAsking = false;
    this.receive(answer);
  }

  receive({ ok, status, detail, body }) {
    if (ok) {
      this.answeredAt = new Date(this.now());
      this.setState("live");
      this.onAnswer(body);
    } else this.setState(status === 401 ? "login" : "lost", detail);
  }

  setState(name, detail = "") {
    if (name === this.state) return;
    this.state = name;
    this.onState({ name, since: this.answeredAt, detail });
  }
}

// Calls `onTick` each second, also while the page is hidden: there a browser lets a page's own timers run once a minute, but
// not those of a worker. `script` is the worker's address (pages/ticker.js). Without one, a hidden page ticks late.
export function startTicking(onTick, script, { makeWorker = (url) => new Worker(url) } = {}) {
  const tickHere = () => setInterval(onTick, TICK_MS);
  try {
    const worker = makeWorker(script);
    worker.addEventListener("message", onTick);
    worker.addEventListener("error", tickHere, { once: true });
  } catch {
    tickHere();
  }
}

// The same for a page that asks nothing while nobody sees it.
export function tickWhileSeen(onTick) {
  const tick = () => document.hidden || onTick();
  setInterval(tick, TICK_MS);
  document.addEventListener("visibilitychange", tick);
  tick();
}
