// Whether this person is available, as the server has it: what a page sends, and what it says of a change by itself. Pure.
// A page must not make somebody available who did not choose that: it sends a choice once, as a person pressed it, and once more
// when the server, and not the page, was away for so long that it forgot the choice.

const CHOICE_MS = 10_000; // time limit for sending a choice, as the server's for a silent page
const SILENT_MS = 10_000; // after this silence the server counts somebody as away

export class Availability {
  constructor({ now = () => Date.now() } = {}) {
    this.now = now;
    this.state = ""; // unknown yet
    this.isAvailable = false; // what this person chose, also while busy
    this.isOffered = false;
    /** @type {{why: "silent" | "unanswered" | "other", from: Date, to: Date} | null} */
    this.lapse = null; // why this person is away, where that was not chosen here
    /** @type {{state: string, at: number} | null} */
    this.choice = null;
    this.lastChoice = ""; // of a person on this page
    this.heardAt = now();
    this.askedAt = now();
    this.slept = false; // since the last answer
  }

  // `state`: available or away.
  choose(state) {
    this.choice = { state, at: this.now() };
    this.lastChoice = state;
    this.lapse = null;
  }

  // What the next heartbeat sends; without a choice it changes nothing.
  get body() {
    const { choice } = this;
    this.slept ||= this.now() - this.askedAt > SILENT_MS;
    this.askedAt = this.now();
    if (choice && this.now() - choice.at > CHOICE_MS) this.choice = null;
    return this.choice ? { state: this.choice.state } : {};
  }

  // `sent` is the body of the heartbeat that this QueueView answers.
  receive({ state, available = state !== "away", offer = null }, sent) {
    if (sent.state === this.choice?.state) this.choice = null;
    if (available) this.lapse = null;
    else if (this.isAvailable && sent.state !== "away") this.noteLapse();
    this.state = state;
    this.isAvailable = available;
    this.isOffered = offer !== null;
    this.heardAt = this.now();
    this.slept = false;
  }

  noteLapse() {
    const known = this.isOffered ? "unanswered" : "other";
    const why = this.now() - this.heardAt > SILENT_MS ? "silent" : known;
    if (why === "silent" && !this.slept && this.lastChoice !== "away") return this.choose("available");
    this.lapse = { why, from: new Date(this.heardAt), to: new Date(this.now()) };
  }
}
