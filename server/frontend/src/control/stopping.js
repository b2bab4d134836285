// What the Stop button does: sends the stop by every path, none waiting for another, and sends it again
// until the server has it. What it shows is what is confirmed and nothing more. Pure except for its timer.

import { randomKey } from "../client/session.js";

export const AGAIN_MS = 1000;
export const TRIES = 15;
const CONFIRM_MS = 5000; // time limit for the control object; after it the stop is released again

// `a` and `b` as in the control object; the robot's confirmation makes no other stop of one.
export const sameStop = (a, b) => a?.by === b?.by && a?.at === b?.at;

export class Stopping {
  // `send(press)` says it on the page's own connection, if that is open; `post(press)` asks the API and
  // gives {ok, status, detail}; `press` as of Session.stopRobot. `onChange()` reports that `shown` may be another.
  /** @param {{send: (press: string) => void, post: (press: string) => Promise<{ok: boolean, status: number, detail: string}>, onChange: () => void}} options */
  constructor({ send, post, onChange }) {
    this.send = send;
    this.post = post;
    this.onChange = onChange;
    /** @type {import("../client/session.js").Control["stopped"]} */
    this.stopped = null;
    /** @type {"idle" | "asked" | "heard" | "unheard" | "failed" | "refused"} */
    this.state = "idle"; // "asked": no answer yet; "heard": the server has it
    this.detail = "";
    this.round = 0;
    this.informed = false; // whether a control object has come since the press
  }

  press() {
    this.round += 1;
    this.state = "asked";
    this.informed = false;
    this.attempt(this.round, TRIES);
    this.onChange();
  }

  async attempt(round, tries) {
    clearTimeout(this.timer);
    const press = randomKey();
    this.send(press);
    const answer = await this.post(press);
    if (round === this.round) this.settle(answer, round, tries - 1);
  }

  settle({ ok, status, detail }, round, tries) {
    if (this.state === "idle") return; // the control object has come meanwhile
    this.detail = detail;
    this.state = ok ? "heard" : refusal(status, tries);
    if (ok) this.later(CONFIRM_MS, () => this.expire());
    else if (this.state === "unheard") this.later(AGAIN_MS, () => this.attempt(round, tries));
    this.onChange();
  }

  later(ms, act) {
    clearTimeout(this.timer);
    this.timer = setTimeout(act, ms);
  }

  // `stopped` of the control object.
  receive(stopped) {
    const before = this.stopped;
    this.stopped = stopped ?? null;
    this.informed = true;
    // An earlier stop, or its release, says nothing of one that is still on its way.
    const onItsWay = ["asked", "unheard"].includes(this.state);
    const another = this.stopped && !sameStop(before, this.stopped);
    if (another || (before && !onItsWay)) this.becomeIdle();
    else this.onChange();
  }

  // A page that hears nothing, as without its links, knows no more than that the server has it.
  expire() {
    if (this.informed) this.becomeIdle();
    else this.later(CONFIRM_MS, () => this.expire());
  }

  becomeIdle() {
    clearTimeout(this.timer);
    this.state = "idle";
    this.onChange();
  }

  // Whether the robot is stopped or may be soon. A stop that failed keeps nobody from going on.
  get holds() {
    return this.stopped !== null || ["asked", "heard", "unheard"].includes(this.state);
  }

  // {kind, by, at, detail}: "none", "asked", "heard", "unheard" (tried again), "failed", "refused", "stopping"
  // (the robot has not confirmed it), "stopped".
  get shown() {
    if (!this.stopped) return { kind: this.state === "idle" ? "none" : this.state, detail: this.detail };
    const { by, at, confirmed } = this.stopped;
    return { kind: confirmed ? "stopped" : "stopping", by, at };
  }
}

// An answer that another attempt cannot change ends them.
export function refusal(status, tries) {
  if (status !== 0 && status !== 429 && status < 500) return "refused";
  return tries > 0 ? "unheard" : "failed";
}
