// What a person reads of connection, control and stops, and what they can do about it: the banner, who drives, and questions.
// The markup is the server's (drive.html); what can be done is driveMode.js's to say.

import { api, serverClock } from "../dom/calls.js";
import { byTestId, keepFocus, localTime, part, setIfOther, setText } from "../dom/page.js";
import { NEW_MS, isNew, markNew } from "../dom/presses.js";
import { connection, control as texts, driveMode as notes, logIn, states } from "../texts/common.js";

/** @typedef {import("../client/session.js").Control} Control */

const TICK_MS = 500;
const FRESH_MS = 8000; // time for which a note lies over the video

export class ControlPanel {
  // `busy` as of Question, `driveTopic` and `isLimitedByAge` as of settings.js.
  constructor(root, { robot, mac, driveMode, driveTopic, isLimitedByAge, busy }) {
    this.root = root;
    this.lease = (action, more = {}) => api.lease(robot, action, more, mac);
    this.driveMode = driveMode;
    this.lack = driveMode.mayDrive && !driveTopic ? texts.noDriveTopic : "";
    this.isLimitedByAge = isLimitedByAge;
    this.live = false;
    this.waits = false;
    this.outdated = false; // whether rights or settings are others than those that the page was made with
    this.note = driveMode.note; // that is shown
    this.element = byTestId(root, "control");
    this.questionElement = byTestId(root, "question");
    this.sureElement = byTestId(root, "take-sure");
    this.question = new Question(this.questionElement, { busy });
    this.sure = new Question(this.sureElement, { busy });
    this.listen();
    setInterval(() => this.count(), TICK_MS);
  }

  listen() {
    const acts = {
      arm: () => this.driveMode.arm(),
      drive: () => this.driveMode.drive(),
      leave: () => this.driveMode.leave(),
      ask: () => this.ask(),
      withdraw: () => this.withdraw(),
      take: () => this.askSure(true),
      "take-yes": () => this.take(),
      "take-no": () => this.askSure(false),
      "hand-over": () => this.handOver(),
      refuse: () => this.answer("refuse"),
    };
    for (const [name, act] of Object.entries(acts)) {
      const button = this.button(name);
      button?.addEventListener("click", () => isNew(button) || act());
    }
  }

  /** @returns {HTMLButtonElement | null} */
  button(name) {
    return document.querySelector(`[data-action="${name}"]`);
  }

  // `live`: the connection stands; `waits` as of connection.js.
  show({ live, waits } = { live: this.live, waits: this.waits }) {
    Object.assign(this, { live, waits });
    const { driveMode } = this;
    this.element.dataset.mode = driveMode.mode;
    this.showDriver(driverText(driveMode, waits));
    const outdated = live && this.outdated ? texts.outdated : "";
    this.showNote(driveMode.note, [this.lack, outdated, guardText(driveMode.control, this.isLimitedByAge)]);
    setText(this.button("drive"), driveMode.busy === "busy_window" ? texts.driveHere : texts.drive);
    const actions = driveMode.actions(live, waits);
    this.showActions(actions);
    if (!actions.includes("take") || driveMode.control.driver?.user !== this.sureOf) this.askSure(false);
    this.showQuestion();
    this.count();
  }

  // A long name may be cut in the header; the drawer has room for it.
  showDriver(text) {
    setText(part(this.element, "driver"), text);
    setText(part(this.root, "driver-whole"), text);
  }

  // What has happened goes from the video after a while; what lasts, as that the robot is not guarded, stays.
  showNote(note, all) {
    const element = byTestId(this.root, "control-note");
    const lasting = all.filter(Boolean).join(" ");
    const text = [noteText(note), lasting].join(" ").trim();
    if (note === this.note && text === element.textContent) return; // the same may happen again
    this.note = note;
    setText(element, text);
    element.dataset.fresh = "true";
    clearTimeout(this.fading);
    if (!lasting) this.fading = setTimeout(() => (element.dataset.fresh = "false"), FRESH_MS);
  }

  // The second press of a double one must not end what the first began.
  showActions(actions) {
    const buttons = [...part(this.root, "actions").querySelectorAll("[data-action]")];
    const before = buttons.filter((button) => !button.hidden);
    const show = () => buttons.forEach((button) => (button.hidden = !actions.includes(button.dataset.action)));
    keepFocus(show, buttons, this.element);
    if (before.some((button) => button.hidden)) buttons.filter((button) => !button.hidden && !before.includes(button)).forEach(markNew);
  }

  // That of another person is another question: the newest state alone may have come.
  showQuestion() {
    const { asking } = this.driveMode;
    if (asking?.user !== this.asker) this.question.show(false);
    this.asker = asking?.user;
    this.question.show(Boolean(asking));
    setText(part(this.questionElement, "text"), asking ? texts.asks(asking.user) : "");
  }

  // The seconds change outside of the live regions, which would be read out each time.
  count() {
    const { asking, asked, control, me } = this.driveMode;
    const left = (waiting) => serverClock.secondsUntil(waiting.passes_at);
    setText(part(this.questionElement, "left"), asking ? texts.passes(asking.user, left(asking)) : "");
    const mine = asked && control.waiting?.user === me && control.driver ? control.waiting : null;
    setText(byTestId(this.root, "control-left"), mine ? texts.arrives(control.driver.user, left(mine)) : "");
  }

  async ask() {
    this.driveMode.ask();
    const answer = await this.lease("ask");
    if (answer.ok || this.driveMode.asked !== "sent") return;
    if (answer.code === "lease_free") this.driveMode.drive();
    else this.driveMode.forget(failure(answer));
  }

  async withdraw() {
    this.driveMode.withdraw();
    const answer = await this.lease("withdraw");
    if (!answer.ok && answer.code !== "nobody_asks") this.driveMode.setNote(failure(answer));
  }

  askSure(sure) {
    const { driver } = this.driveMode.control;
    const changes = this.sure.shown !== sure;
    this.sure.show(sure);
    this.sureOf = sure ? driver?.user : undefined; // control is taken from nobody else
    setText(part(this.sureElement, "text"), sure && driver ? texts.takeSure(driver.user) : "");
    if (changes && sure) this.button("take-no")?.focus();
  }

  async take() {
    const driver = this.sureOf; // another one may drive, whom this page does not show yet
    this.askSure(false);
    const answer = await this.lease("take", { driver });
    if (answer.ok || answer.code === "lease_free") this.driveMode.drive();
    else this.driveMode.setNote(failure(answer));
  }

  // To the person named in the question, who may have withdrawn it.
  handOver() {
    const { asking } = this.driveMode;
    if (!asking) return;
    this.driveMode.handedTo = asking.user; // control may go before the answer comes
    this.answer("hand_over", { to: asking.user });
  }

  async answer(action, more) {
    this.question.show(false);
    const answer = await this.lease(action, more);
    if (answer.ok) return;
    this.driveMode.handedTo = "";
    if (answer.code === "nobody_asks") return;
    this.driveMode.setNote(failure(answer));
    this.showQuestion();
  }
}

const failure = ({ detail }) => ({ why: "failed", reason: texts.failed(detail) });

const noteText = (note) => notes[note?.why]?.(note) ?? "";

function guardText({ guard, blind_limits }, isLimitedByAge) {
  if (guard === "down") return texts.guardDown;
  if (guard === "off") return texts.guardOff;
  return isLimitedByAge && blind_limits === false ? texts.guardOld : "";
}

// Empty while nobody says who drives.
const driverText = (driveMode, waits) => (driveMode.known && !waits ? holderText(driveMode) : "");

function holderText({ control, me, driving }) {
  const { driver, reserved, waiting } = control;
  if (driver) {
    const also = waiting && waiting.user !== me && !driving ? texts.waiting(waiting.user) : "";
    return whoDrives(driver, me, driving) + also;
  }
  if (reserved) return reserved.user === me ? texts.reservedForYou : texts.reserved(reserved.user);
  return texts.nobody;
}

function whoDrives({ user, since }, me, driving) {
  if (user !== me) return texts.other(user, localTime(since));
  return driving ? texts.you : texts.yourOther;
}

// The banner shows the state, in a word in the header and over the video where something is wrong, and offers what a
// person can do about that.
const bannerTexts = { ...connection, ...states };

export class Banner {
  // `onRetry()`: try to connect now; `onBlind()`: a person wants to drive without video.
  constructor(root, { onRetry, onBlind }) {
    this.element = byTestId(root, "state");
    this.pill = byTestId(root, "control");
    this.button = part(this.element, "state-action");
    this.button.addEventListener("click", () => this.act());
    this.onRetry = onRetry;
    this.onBlind = onBlind;
    this.offered = undefined;
  }

  // `state` as of connection.js; `facts` are those of `selectStatus` and what the sentences need.
  show(state, facts) {
    this.state = state;
    this.shown = selectStatus(state, facts);
    this.renamed = facts.renamed;
    const text = bannerTexts[this.shown];
    this.element.dataset.state = state.name;
    this.element.dataset.shown = this.shown;
    this.pill.dataset.shown = this.shown;
    setText(part(this.pill, "pill-state"), text.title);
    setText(part(this.element, "state-title"), text.headline?.(facts) ?? text.title);
    setText(part(this.element, "state-detail"), text.detail({ ...facts, reason: state.reason, answered: state.code !== undefined }));
    this.offer(state.login ? logIn : text.action);
  }

  offer(action) {
    if (this.offered && action !== this.offered) markNew(this.button);
    this.offered = action;
    setText(this.button, action ?? "");
    keepFocus(() => (this.button.hidden = !action), [], this.element);
  }

  act() {
    if (isNew(this.button)) return;
    const page = this.nextPage;
    if (page) location.assign(page);
    else if (this.shown === "not_allowed") location.reload();
    else if (this.shown === "held") this.onBlind();
    else this.onRetry();
  }

  // Where the button leads; empty where it stays on this page.
  get nextPage() {
    if (this.state.login) return `/login?next=${encodeURIComponent(location.pathname)}`;
    if (this.shown === "renamed") return `/robots/${encodeURIComponent(this.renamed)}`;
    return this.shown === "gone" ? "/" : "";
  }
}

// The one state that the page's banner shows, out of all that is true at once: what keeps the robot from driving
// comes first. Pure.
const AWAY = ["offline", "link_lost"]; // what a robot is that was disabled

// `state` is the connection's (connection.js); `control` as in docs/reference/protocols.md, `video` the kind of the
// VideoInterlock; `disabled` by an administrator; `slow` when commands come too late to count; `silentS` as of `silenceOf`;
// `renamed` is the name that a robot that is gone has now.
export function selectStatus(state, facts) {
  if (state.gone) return facts.renamed ? "renamed" : "gone";
  if (state.name !== "live") return facts.disabled ? asDisabled(state.name) : state.name;
  return robotStatus(facts.control ?? {}) ?? linkStatus(facts) ?? "live";
}

function linkStatus(/** @type {any} */ { driving, video, slow, silentS }) {
  if (silentS) return "silent";
  return driving ? drivingStatus(video, slow) : null;
}

// For how many whole seconds neither the server nor the video has come; 0 for less than one. `frameMs` null for no frame.
export function silenceOf(serverMs, frameMs) {
  return Math.floor(Math.min(serverMs, frameMs ?? Infinity) / 1000);
}

// Whether commands come too late to count: `server` and `robot` as of latencyBreakdown, the ways there and back; `maxAgeMs`
// as of settings.js.
export const isSlow = ({ server, robot }, maxAgeMs) => (server + robot) / 2 > maxAgeMs;

const asDisabled = (name) => (AWAY.includes(name) ? "disabled" : name);

function robotStatus(/** @type {Partial<Control>} */ { stopped, guard }) {
  if (stopped) return stopped.confirmed ? "stopped" : "stopping";
  return guard === "down" ? "guard_down" : null;
}

// Whoever watches is held by nothing.
function drivingStatus(video, slow) {
  if (video === "missing" || video === "old") return "held";
  if (slow) return "slow";
  return video === "blind" ? "blind" : null;
}

// A question that comes up by itself, over the video. It accepts no input while it is new and while somebody drives: what is
// pressed then was meant for what stood there before, or slipped off the stick.
const CHECK_MS = 100;

export class Question {
  // `busy()` says whether a key or stick is held.
  constructor(element, { busy = () => false, now = () => performance.now() } = {}) {
    this.element = element;
    this.busy = busy;
    this.now = now;
    this.shownAt = -Infinity;
    element.addEventListener("click", (event) => this.sift(event), { capture: true });
    setInterval(() => this.mark(), CHECK_MS);
  }

  get shown() {
    return !this.element.hidden;
  }

  get deaf() {
    return this.now() - this.shownAt < NEW_MS || this.busy();
  }

  show(visible) {
    if (visible === this.shown) return;
    if (visible) this.shownAt = this.now();
    this.element.hidden = !visible;
    this.mark();
  }

  sift(event) {
    if (!this.deaf) return;
    event.preventDefault();
    event.stopPropagation();
  }

  mark() {
    setIfOther(this.element.dataset, "deaf", String(this.shown && this.deaf));
  }
}
