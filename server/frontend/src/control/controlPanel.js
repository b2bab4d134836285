// The part of the drive page that shows who drives, and lets a person ask, reply, take, start and give up.
// The markup is the server's (drive.html); what can be done is driveMode.js's to say.

import { lease, serverClock } from "../pages/calls.js";
import { byTestId, localTime, part, setText } from "../pages/page.js";
import { control as texts, driveMode as notes } from "../texts/common.js";
import { Question } from "./question.js";

const TICK_MS = 500;

export class ControlPanel {
  // `busy` as of question.js.
  constructor(root, { robot, driveMode, busy }) {
    this.robot = robot;
    this.driveMode = driveMode;
    this.live = false;
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
    for (const [name, act] of Object.entries(acts)) this.button(name)?.addEventListener("click", act);
  }

  /** @returns {HTMLButtonElement | null} */
  button(name) {
    return document.querySelector(`[data-deed="${name}"]`);
  }

  // `live`: the connection stands.
  show(live = this.live) {
    this.live = live;
    const { driveMode } = this;
    this.element.dataset.mode = driveMode.mode;
    setText(part(this.element, "driver"), driverText(driveMode));
    setText(part(this.element, "note"), [noteText(driveMode.note), guardText(driveMode.control)].join(" ").trim());
    setText(this.button("drive"), driveMode.busy === "busy_window" ? texts.driveHere : texts.drive);
    const actions = driveMode.actions(live);
    this.showActions(actions);
    if (!actions.includes("take")) this.askSure(false);
    this.showQuestion();
    this.count();
  }

  // A button that goes while it has the focus hands it to what came in its place.
  showActions(actions) {
    const buttons = [...part(this.element, "deeds").querySelectorAll("[data-deed]")];
    const focused = buttons.find((button) => button === document.activeElement);
    for (const button of buttons) button.hidden = !actions.includes(button.dataset.deed);
    if (focused?.hidden) (buttons.find((button) => !button.hidden) ?? this.element).focus();
  }

  showQuestion() {
    const { asking } = this.driveMode;
    this.question.show(Boolean(asking));
    setText(part(this.questionElement, "text"), asking ? texts.asks(asking.user) : "");
  }

  // The seconds change outside of the live regions, which would be read out each time.
  count() {
    const { asking, asked, control, me } = this.driveMode;
    const left = (waiting) => serverClock.secondsUntil(waiting.passes_at);
    setText(part(this.questionElement, "left"), asking ? texts.passes(left(asking)) : "");
    const mine = asked && control.waiting?.user === me && control.driver ? control.waiting : null;
    setText(part(this.element, "left"), mine ? texts.arrives(control.driver.user, left(mine)) : "");
  }

  async ask() {
    this.driveMode.ask();
    const answer = await lease(this.robot, "ask");
    if (answer.ok || this.driveMode.asked !== "sent") return;
    if (answer.code === "lease_free") this.driveMode.drive();
    else this.driveMode.forget(failure(answer));
  }

  async withdraw() {
    this.driveMode.forget();
    await lease(this.robot, "withdraw");
  }

  askSure(sure) {
    const { driver } = this.driveMode.control;
    const changes = this.sure.shown !== sure;
    this.sure.show(sure);
    setText(part(this.sureElement, "text"), sure && driver ? texts.takeSure(driver.user) : "");
    if (changes && sure) this.button("take-no")?.focus();
  }

  async take() {
    this.askSure(false);
    const answer = await lease(this.robot, "take");
    if (answer.ok || answer.code === "lease_free") this.driveMode.drive();
    else this.driveMode.setNote(failure(answer));
  }

  // To the one whom the person reads of, who may have taken the question back.
  handOver() {
    const { asking } = this.driveMode;
    if (asking) this.answer("hand_over", { to: asking.user });
  }

  async answer(action, more) {
    this.question.show(false);
    const answer = await lease(this.robot, action, more);
    if (answer.ok || answer.code === "nobody_asks") return;
    this.driveMode.setNote(failure(answer));
    this.showQuestion();
  }
}

const failure = ({ detail }) => ({ why: "failed", reason: texts.failed(detail) });

const noteText = (note) => notes[note?.why]?.(note) ?? "";

function guardText({ guard }) {
  if (guard === "down") return texts.guardDown;
  return guard === "off" ? texts.guardOff : "";
}

function driverText({ control, me, driving }) {
  const { driver, reserved, waiting } = control;
  if (driver) {
    const also = waiting && waiting.user !== me && !driving ? ` ${texts.waiting(waiting.user)}` : "";
    return whoDrives(driver, me, driving) + also;
  }
  if (reserved) return reserved.user === me ? texts.reservedForYou : texts.reserved(reserved.user);
  return texts.nobody;
}

function whoDrives({ user, since }, me, driving) {
  const time = localTime(since);
  if (user !== me) return texts.other(user, time);
  return driving ? texts.you(time) : texts.yourOther(time);
}
