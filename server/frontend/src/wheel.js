// The part of the drive page that says who drives and lets a person ask, answer, take, begin and give up.
// The markup is the server's (drive.html); what can be done is seat.js's to say.

import { lease } from "./calls.js";
import { serverClock } from "./clock.js";
import { byTestId, localTime, part, setText } from "./page.js";
import { Question } from "./question.js";
import { control as texts, seat as notes } from "./texts.js";

const TICK_MS = 500;

export class Wheel {
  // `busy` as of question.js.
  constructor(root, { robot, seat, busy }) {
    this.robot = robot;
    this.seat = seat;
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
      arm: () => this.seat.arm(),
      drive: () => this.seat.drive(),
      leave: () => this.seat.leave(),
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

  button(name) {
    return document.querySelector(`[data-deed="${name}"]`);
  }

  // `live`: the connection stands.
  show(live = this.live) {
    this.live = live;
    const { seat } = this;
    this.element.dataset.mode = seat.mode;
    setText(part(this.element, "driver"), driverText(seat));
    setText(part(this.element, "note"), [noteText(seat.note), guardText(seat.control)].join(" ").trim());
    setText(this.button("drive"), seat.busy === "busy_window" ? texts.driveHere : texts.drive);
    const deeds = seat.deeds(live);
    this.showDeeds(deeds);
    if (!deeds.includes("take")) this.askSure(false);
    this.showQuestion();
    this.count();
  }

  // A button that goes while it has the focus hands it to what came in its place.
  showDeeds(deeds) {
    const buttons = [...part(this.element, "deeds").querySelectorAll("[data-deed]")];
    const focused = buttons.find((button) => button === document.activeElement);
    for (const button of buttons) button.hidden = !deeds.includes(button.dataset.deed);
    if (focused?.hidden) (buttons.find((button) => !button.hidden) ?? this.element).focus();
  }

  showQuestion() {
    const { asking } = this.seat;
    this.question.show(Boolean(asking));
    setText(part(this.questionElement, "text"), asking ? texts.asks(asking.user) : "");
  }

  // The seconds change outside of the live regions, which would be read out each time.
  count() {
    const { asking, asked, control, me } = this.seat;
    const left = (waiting) => serverClock.secondsUntil(waiting.passes_at);
    setText(part(this.questionElement, "left"), asking ? texts.passes(left(asking)) : "");
    const mine = asked && control.waiting?.user === me && control.driver ? control.waiting : null;
    setText(
      part(this.element, "left"),
      mine ? texts.arrives(control.driver.user, left(mine)) : "",
    );
  }

  async ask() {
    this.seat.ask();
    const answer = await lease(this.robot, "ask");
    if (answer.ok || this.seat.asked !== "sent") return;
    if (answer.code === "lease_free") this.seat.drive();
    else this.seat.forget(failure(answer));
  }

  async withdraw() {
    this.seat.forget();
    await lease(this.robot, "withdraw");
  }

  askSure(sure) {
    const { driver } = this.seat.control;
    const changes = this.sure.shown !== sure;
    this.sure.show(sure);
    setText(part(this.sureElement, "text"), sure && driver ? texts.takeSure(driver.user) : "");
    if (changes && sure) this.button("take-no").focus();
  }

  async take() {
    this.askSure(false);
    const answer = await lease(this.robot, "take");
    if (answer.ok || answer.code === "lease_free") this.seat.drive();
    else this.seat.say(failure(answer));
  }

  // To the one whom the person reads of, who may have taken the question back.
  handOver() {
    const { asking } = this.seat;
    if (asking) this.answer("hand_over", { to: asking.user });
  }

  async answer(action, more) {
    this.question.show(false);
    const answer = await lease(this.robot, action, more);
    if (answer.ok || answer.code === "nobody_asks") return;
    this.seat.say(failure(answer));
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
