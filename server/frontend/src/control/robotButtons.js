// The robot's buttons (settings.buttons): what a press does, and what is known of it. Pure except for its timers.
// It must send nothing unless this page drives, and nothing twice that waits for its answer.

import { ask } from "../client/driveType.js";
import { fullName } from "../client/rosbridge.js";
import { make, part, setText } from "../dom/page.js";
import { DOUBLE_MS } from "../dom/presses.js";
import { buttons as texts } from "../texts/panels.js";

const ASKING_MS = 10_000; // time limit for an answer: a forgotten question must not be hit later
const SLOW_MS = 30_000;
const ROSBRIDGE_S = SLOW_MS / 1000 + 1; // time limit for rosbridge, which would call a service failed that it waits for

export class RobotButtons {
  // `connection` as of connection.js; `onChange(action)` reports an action
  // whose `state`, `words` or `open` (a question that can be answered by now) changed. States: idle, asking, pending,
  // sent, done, failed, unknown.
  constructor({ buttons, connection, onChange }) {
    this.connection = connection;
    this.onChange = onChange;
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
    action.publisher = this.connection.advertise({ name: topic, type, onRefused });
  }

  forget(action) {
    action.publisher?.end();
    action.publisher = null;
    if (action.state === "pending") this.doubt(action, texts.lost);
    if (action.state === "asking") this.set(action, "idle");
  }

  press(action) {
    if (!this.usable || action.state === "pending" || action.state === "asking") return;
    if (action.button.confirm) this.ask(action);
    else this.run(action);
  }

  // The second press of a double one is no answer.
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
    const { name, topic, msg } = action.button;
    if (!action.publisher?.publish(msg)) return this.fail(action, texts.notConnected);
    this.set(action, "sent", texts.sentWords(name));
    this.checkHeard(action, fullName(topic));
  }

  // What reached nobody was not done. A rosapi that knows no publisher, not even this page, hides the topic. That of
  // ROS 2 sees no program without a node, nor nodes of some other releases, which may have got it.
  async checkHeard(action, topic) {
    const { round } = action;
    const call = (service, request) => this.connection.call(service, request);
    const nodes = async (kind) => (await ask(call, `/rosapi/${kind}`, { topic }))[kind];
    const [publishers, subscribers] = await Promise.all(["publishers", "subscribers"].map(nodes)).catch(() => []);
    if (round !== action.round || !publishers?.length || subscribers?.length !== 0) return;
    if (action.button.type.includes("/msg/")) this.doubt(action, texts.unseen(topic), round);
    else this.fail(action, texts.unheard(topic), round);
  }

  async request(action) {
    const { name, service, args, type } = action.button;
    this.set(action, "pending", texts.pendingWords(name));
    const { round } = action;
    action.timer = setTimeout(() => this.doubt(action, texts.slow(SLOW_MS / 1000), round), SLOW_MS);
    const answer = await this.connection.call(service, args, type || undefined, ROSBRIDGE_S).catch(() => null);
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

  // Nobody here knows whether the robot did it.
  doubt(action, why, round) {
    this.set(action, "unknown", texts.unknownWords(action.button.name, why), round);
  }

  set(action, state, words = "", round = action.round + 1) {
    clearTimeout(action.timer);
    clearTimeout(action.opening);
    Object.assign(action, { state, words, round, open: false });
    this.onChange(action);
  }
}

// What a service's answer, or its refusal, means to a person. Pure.
const MAX_WORDS = 300;

// `ok`, `values` as of connection.js's call. std_srvs says in `success` whether it was done.
export const succeeded = ({ ok, values }) => ok && values?.success !== false;

// The answer's own message, or else what it holds beside `success`.
export function answerWords({ values }) {
  if (typeof values === "string") return shortened(values);
  const { success, message, ...more } = values ?? {};
  if (typeof message === "string") return shortened(message);
  if (success !== undefined && Object.keys(more).length === 0) return "";
  return Object.keys(more).length ? shortened(JSON.stringify(more)) : "";
}

export const refusalWords = (why) => shortened(String(why ?? ""));

const shortened = (text) => (text.length > MAX_WORDS ? `${text.slice(0, MAX_WORDS)}…` : text);

// The robot's buttons on the drive page. What a press does is decided above.
// Nothing here changes its size while somebody drives: what is asked takes the place of the button that was pressed.
export class Buttons {
  // `root` is the panel; `connection` as of connection.js.
  constructor(root, { buttons, connection }) {
    this.root = root;
    this.robotButtons = new RobotButtons({ buttons, connection, onChange: (action) => this.show(action) });
    this.cells = new Map(this.robotButtons.all.map((action, place) => [action, this.cell(action, place)]));
    part(root, "button-list").append(...[...this.cells.values()].map(({ item }) => item));
    root.hidden = buttons.length === 0;
    this.use({ live: false, driving: false });
  }

  use(now) {
    this.robotButtons.use(now);
    for (const action of this.robotButtons.all) this.show(action);
    setText(part(this.root, "button-hint"), texts.hint(this.robotButtons.usable));
  }

  cell(action, place) {
    const { name } = action.button;
    const state = make("small");
    const press = make("button", { type: "button", title: name, "data-testid": `button-${place}` }, make("span", {}, name), state);
    const yes = make("button", { type: "button", class: "main", "data-testid": `button-${place}-yes` }, texts.yes(name));
    const no = make("button", { type: "button", "data-testid": `button-${place}-no` }, texts.no);
    const question = make("span", { class: "button-sure", role: "group", "aria-label": texts.yes(name) }, yes, no);
    press.addEventListener("click", () => this.robotButtons.press(action));
    yes.addEventListener("click", () => this.robotButtons.confirm(action));
    no.addEventListener("click", () => this.robotButtons.cancel(action));
    return { item: make("li", {}, press, question), press, question, yes, no, state };
  }

  // A button that goes while it has the focus hands it to what came in its place.
  show(action) {
    const cell = this.cells?.get(action);
    if (!cell) return;
    const asking = action.state === "asking";
    const focused = [cell.press, cell.yes, cell.no].find((button) => button === document.activeElement);
    cell.press.hidden = asking;
    cell.question.hidden = !asking;
    cell.yes.disabled = !action.open;
    cell.press.dataset.state = action.state;
    // Not `disabled`: a button that is switched off while it has the focus would drop it.
    cell.press.setAttribute("aria-disabled", String(!this.robotButtons.usable || action.state === "pending"));
    setText(cell.state, texts[action.state]);
    // Without a scroll, which would move the stick.
    if (focused?.closest("[hidden]")) (asking ? cell.no : cell.press).focus({ preventScroll: true });
    this.report(action);
  }

  report(action) {
    const reported = `${action.round} ${action.words}`;
    if (!action.words || reported === action.reported) return;
    action.reported = reported;
    setText(part(this.root, "button-outcome"), action.words);
  }
}
