// The robot's buttons (settings.buttons): what a press does, and what is known of it. Pure but for its timers.
// It must send nothing unless this page drives, and nothing twice that waits for its answer.

import { buttons as texts } from "../texts/panels.js";
import { answerWords, refusalWords, succeeded } from "./answers.js";

const ASKING_MS = 10_000; // a question that is forgotten must not be there to be hit later
const DOUBLE_MS = 500; // the second press of a double one is no answer to what came up under it
const SLOW_MS = 30_000;

export class RobotButtons {
  // `advertise(spec)` and `call(service, args, type)` as of connection.js; `onChange(action)` reports an action
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
    for (const action of this.all) {
      if (usable) this.prepare(action);
      else this.forget(action);
      this.onChange(action);
    }
  }

  prepare(action) {
    const { kind, topic, type } = action.button;
    if (kind !== "publish") return;
    const onRefused = (why) => this.fail(action, refusalWords(why));
    action.publisher = this.advertise({ name: topic, type, onRefused });
  }

  forget(action) {
    action.publisher?.end();
    action.publisher = null;
    if (action.state === "pending") this.fail(action, texts.lost);
    if (action.state === "asking") this.set(action, "idle");
  }

  press(action) {
    if (!this.usable || action.state === "pending" || action.state === "asking") return;
    if (action.button.confirm) this.ask(action);
    else this.run(action);
  }

  ask(action) {
    this.set(action, "asking");
    action.timer = setTimeout(() => this.cancel(action), ASKING_MS);
    action.opening = setTimeout(() => this.open(action), DOUBLE_MS);
  }

  open(action) {
    action.open = true;
    this.onChange(action);
  }

  confirm(action) {
    if (this.usable && action.open) this.run(action);
  }

  cancel(action) {
    if (action.state === "asking") this.set(action, "idle");
  }

  run(action) {
    if (action.button.kind === "publish") this.publish(action);
    else this.request(action);
  }

  publish(action) {
    if (action.publisher?.publish(action.button.msg)) this.set(action, "sent", texts.sentWords(action.button.name));
    else this.fail(action, texts.notConnected);
  }

  async request(action) {
    const { name, service, args, type } = action.button;
    this.set(action, "pending", texts.pendingWords(name));
    const { round } = action;
    action.timer = setTimeout(() => this.fail(action, texts.slow(SLOW_MS / 1000), round), SLOW_MS);
    const answer = await this.call(service, args, type || undefined).catch(() => null);
    if (round === action.round) this.settle(action, answer, round);
  }

  // An answer that comes after the page gave up waiting still counts, unless it was pressed anew.
  settle(action, answer, round) {
    if (!answer) this.fail(action, texts.notConnected, round);
    else if (!succeeded(answer)) this.fail(action, answerWords(answer), round);
    else this.set(action, "done", texts.doneWords(action.button.name, answerWords(answer)), round);
  }

  fail(action, why, round) {
    this.set(action, "failed", texts.failedWords(action.button.name, why), round);
  }

  set(action, state, words = "", round = action.round + 1) {
    clearTimeout(action.timer);
    clearTimeout(action.opening);
    Object.assign(action, { state, words, round, open: false });
    this.onChange(action);
  }
}
