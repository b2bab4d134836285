// The clock of a drive that is played back: reads ahead of it, and hands over each message when it is due. After a seek it hands over
// what was the case there. It never hands over a message that lies after its time.

const AHEAD_MS = 4000; // of the recording that is read before it is due, at speed 1
const MAX_WAITING_BYTES = 16 * 1024 * 1024;
const MAX_WAITING = 20_000;
const PAUSE_EVERY = 500; // messages after which the page gets a turn
const MAX_STEP_MS = 250; // of a page that was busy or hidden
const RECENT_MS = 2000; // for which the newest message of a topic counts as what is the case
const KEY_WITHIN_MS = 30_000;
const MAX_FRAMES_SINCE_KEY = 900;
const MAX_FIXED = 50; // messages of a topic of which each counts

/**
 * @typedef {import("./recordingReader.js").RecordedMessage} RecordedMessage
 * @typedef {{recent: string[], newest: string[], fixed: string[], frames: string[], isKey: (frame: RecordedMessage) => boolean}} Topics
 *   `recent`: of the last two seconds; `newest`: the newest, however old; `fixed`: all so far; `frames`: since a key frame
 */

export class Player {
  // `reader` as of recordingReader.js. `onReset(messages, atMs)` gets what is the case after a seek, `onMessages(messages, atMs)` what is
  // due, `onState()` comes when anything else changed.
  constructor({ reader, topics, onReset, onMessages, onState, now = () => performance.now() }) {
    this.reader = reader;
    /** @type {Topics} */
    this.topics = topics;
    this.onReset = onReset;
    this.onMessages = onMessages;
    this.onState = onState;
    this.now = now;
    this.atMs = 0;
    this.speed = 1;
    this.playing = false;
    this.seeking = false;
    this.stalled = false;
    this.error = null;
    this.round = 0;
    this.isAsked = false; // another seek came meanwhile
    /** @type {RecordedMessage[]} */
    this.waiting = []; // messages that are not due yet
    this.waitingBytes = 0;
    this.readMs = 0; // up to here nothing more comes
    this.makeRoom = () => {};
  }

  get durationMs() {
    return this.reader.durationMs;
  }

  get loading() {
    return this.seeking || this.stalled;
  }

  play() {
    if (this.error)
      this.seek(this.atMs); // it reads no further by itself
    else if (this.atMs >= this.durationMs) this.seek(0);
    this.playing = true;
    this.lastAt = this.now();
    this.onState();
  }

  pause() {
    this.playing = false;
    this.onState();
  }

  // Other topics from here on, such as those of another camera.
  use(topics) {
    this.topics = topics;
    this.seek(this.atMs);
  }

  // Many seeks in a row, as of a finger, are the last of them.
  async seek(atMs) {
    this.atMs = Math.min(Math.max(atMs, 0), this.durationMs);
    this.isAsked = true;
    this.onState();
    if (this.seeking) return;
    this.seeking = true;
    while (this.isAsked) {
      this.isAsked = false;
      await this.seekOnce(this.atMs);
    }
    this.seeking = false;
    this.lastAt = this.now();
    this.onState();
  }

  async seekOnce(atMs) {
    this.round += 1;
    this.empty();
    try {
      const messages = await this.stateAt(atMs);
      this.error = null;
      if (this.isAsked) return;
      this.onReset(messages, atMs);
      this.readOn(atMs);
    } catch (error) {
      this.fail(error);
    }
  }

  fail(error) {
    this.error = error;
    this.playing = false;
    this.onState();
  }

  empty() {
    this.waiting = [];
    this.waitingBytes = 0;
    this.readMs = 0;
    this.makeRoom();
  }

  // What is the case at a time, the oldest first.
  async stateAt(atMs) {
    const { recent, newest, fixed, frames } = this.topics;
    const messages = await collected(this.reader.messages({ topics: fixed, toMs: atMs }), MAX_FIXED);
    for (const topic of newest) messages.push(...(await collected(this.reader.backwards({ topics: [topic], toMs: atMs }), 1)));
    const since = { topics: recent, afterMs: atMs - RECENT_MS, toMs: atMs };
    messages.push(...(await collected(this.reader.messages(since), MAX_WAITING)), ...(await this.framesUntil(frames, atMs)));
    return messages.sort((a, b) => a.atMs - b.atMs);
  }

  // The newest frame with those that it depends on.
  async framesUntil(topics, atMs) {
    const frames = [];
    for await (const frame of this.reader.backwards({ topics, fromMs: atMs - KEY_WITHIN_MS, toMs: atMs })) {
      frames.unshift(frame);
      if (this.topics.isKey(frame)) return frames;
      if (frames.length >= MAX_FRAMES_SINCE_KEY || this.isAsked) break;
    }
    return [];
  }

  async readOn(afterMs) {
    const { round } = this;
    const { recent, newest, fixed, frames } = this.topics;
    const topics = [...recent, ...newest, ...fixed, ...frames];
    try {
      for await (const message of this.reader.messages({ topics, afterMs })) {
        if (round !== this.round) return;
        await this.take(message);
      }
      if (round === this.round) this.readMs = Infinity;
    } catch (error) {
      if (round === this.round) this.fail(error);
    }
  }

  // Resolves when there is room for the next one.
  async take(message) {
    const { round } = this;
    this.waiting.push(message);
    this.waitingBytes += message.data.length;
    this.readMs = message.atMs;
    if (this.waiting.length % PAUSE_EVERY === 0) await new Promise((resolve) => setTimeout(resolve));
    while (round === this.round && this.isFull)
      await new Promise((/** @type {(value?: any) => void} */ resolve) => (this.makeRoom = resolve));
  }

  get isFull() {
    const isAhead = this.readMs > this.atMs + AHEAD_MS * this.speed;
    return isAhead || this.waitingBytes > MAX_WAITING_BYTES || this.waiting.length > MAX_WAITING;
  }

  // Called with each frame of the page.
  tick() {
    const now = this.now();
    const step = Math.min(now - (this.lastAt ?? now), MAX_STEP_MS) * this.speed;
    this.lastAt = now;
    if (!this.playing || this.seeking) return;
    const target = Math.min(this.atMs + step, this.durationMs);
    const wasStalled = this.stalled;
    this.stalled = target > this.readMs;
    this.atMs = Math.max(this.atMs, Math.min(target, this.readMs));
    this.handOver();
    if (this.atMs >= this.durationMs) this.pause();
    if (wasStalled !== this.stalled) this.onState();
  }

  handOver() {
    const later = this.waiting.findIndex(({ atMs }) => atMs > this.atMs);
    const due = this.waiting.splice(0, later < 0 ? this.waiting.length : later);
    for (const { data } of due) this.waitingBytes -= data.length;
    this.makeRoom();
    if (due.length) this.onMessages(due, this.atMs);
  }
}

async function collected(messages, most) {
  const list = [];
  for await (const message of messages) {
    list.push(message);
    if (list.length >= most) break;
  }
  return list;
}
