// The robot's buttons (settings.buttons): what a press does, and what is known of it. Pure but for its timers.
// It must send nothing unless this page drives, and nothing twice that waits for its answer.

import { buttons as texts } from "../texts/panels.js";
import { answerWords, refusalWords, succeeded } from "./answers.js";

const ASKING_MS = 10_000; // a question that is forgotten must not be there to be hit later
const DOUBLE_MS = 500; // the second press of a double one is no answer to what came up under it
const SLOW_MS = 30_000;

export class Deeds {
  // `advertise(spec)` and `call(service, args, type)` as of connection.js; `onChange(deed)` tells of a deed
  // whose `state`, `words` or `open` (a question that can be answered by now) changed. States: idle, asking, pending,
  // sent, done, failed.
  constructor({ buttons, advertise, call, onChange }) {
    Object.assign(this, { advertise, call, onChange });
    this.usable = false;
    this.all = buttons.map((button) => ({ button, state: "idle", words: "", round: 0, open: false, publisher: null }));
  }

  // A publisher stands as long as the page drives: ROS loses what is published before its subscribers know it.
  use({ live, driving }) {
    const usable = live && driving;
    if (usable === this.usable) return;
    this.usable = usable;
    for (const deed of this.all) {
      if (usable) this.prepare(deed);
      else this.forget(deed);
      this.onChange(deed);
    }
  }

  prepare(deed) {
    const { kind, topic, type } = deed.button;
    if (kind !== "publish") return;
    const onRefused = (why) => this.fail(deed, refusalWords(why));
    deed.publisher = this.advertise({ name: topic, type, onRefused });
  }

  forget(deed) {
    deed.publisher?.end();
    deed.publisher = null;
    if (deed.state === "pending") this.fail(deed, texts.lost);
    if (deed.state === "asking") this.set(deed, "idle");
  }

  press(deed) {
    if (!this.usable || deed.state === "pending" || deed.state === "asking") return;
    if (deed.button.confirm) this.ask(deed);
    else this.run(deed);
  }

  ask(deed) {
    this.set(deed, "asking");
    deed.timer = setTimeout(() => this.cancel(deed), ASKING_MS);
    deed.opening = setTimeout(() => this.open(deed), DOUBLE_MS);
  }

  open(deed) {
    deed.open = true;
    this.onChange(deed);
  }

  confirm(deed) {
    if (this.usable && deed.open) this.run(deed);
  }

  cancel(deed) {
    if (deed.state === "asking") this.set(deed, "idle");
  }

  run(deed) {
    if (deed.button.kind === "publish") this.publish(deed);
    else this.request(deed);
  }

  publish(deed) {
    if (deed.publisher?.publish(deed.button.msg)) this.set(deed, "sent", texts.sentWords(deed.button.name));
    else this.fail(deed, texts.notConnected);
  }

  async request(deed) {
    const { name, service, args, type } = deed.button;
    this.set(deed, "pending", texts.pendingWords(name));
    const { round } = deed;
    deed.timer = setTimeout(() => this.fail(deed, texts.slow(SLOW_MS / 1000), round), SLOW_MS);
    const answer = await this.call(service, args, type || undefined).catch(() => null);
    if (round === deed.round) this.settle(deed, answer, round);
  }

  // An answer that comes after the page gave up waiting still counts, unless it was pressed anew.
  settle(deed, answer, round) {
    if (!answer) this.fail(deed, texts.notConnected, round);
    else if (!succeeded(answer)) this.fail(deed, answerWords(answer), round);
    else this.set(deed, "done", texts.doneWords(deed.button.name, answerWords(answer)), round);
  }

  fail(deed, why, round) {
    this.set(deed, "failed", texts.failedWords(deed.button.name, why), round);
  }

  set(deed, state, words = "", round = deed.round + 1) {
    clearTimeout(deed.timer);
    clearTimeout(deed.opening);
    Object.assign(deed, { state, words, round, open: false });
    this.onChange(deed);
  }
}
