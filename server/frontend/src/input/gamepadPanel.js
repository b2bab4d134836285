// The gamepad on the page: which one drives, what its sticks and buttons do, and the settings of this device for it.

import { LocalStore, byTestId, part, setText } from "../dom/page.js";
import * as texts from "../texts/inputs.js";
import { DEAD_ZONE, Gamepad, GamepadLoop, MAX_POLL_GAP_MS, MOTIONS, fits, madeOf, usualProfile } from "./gamepad.js";
import { Learner, stepsOf } from "./gamepadLearn.js";

const INPUT = "gamepad";
const TROUBLE = ["lost", "stuck", "uncentred"]; // said over the video, too
const CHOICE = "gamepad"; // the name under which the id of the chosen device is kept
const storedAs = ({ id }) => `gamepad ${id}`;

export class GamepadPanel {
  // `kind`, `limits` and `teleop` as of teleop.js; `onStop()` comes from the stop button.
  constructor(root, { kind, teleop, limits, onStop, store = new LocalStore() }) {
    this.kind = kind;
    this.teleop = teleop;
    this.limits = limits;
    this.store = store;
    this.element = byTestId(root, "gamepad");
    this.trouble = part(root, "pad-trouble");
    this.free = false; // whether its enable button would take the control
    this.device = null;
    this.learner = null;
    this.onStop = onStop;
    this.others = new Map(); // the devices that do not drive, by their index
    this.gamepad = new Gamepad({
      accepts: () => (teleop.armed || (teleop.watching && this.free)) && document.hasFocus(),
      onHold: (input, at) => teleop.hold(INPUT, input, at, MAX_POLL_GAP_MS),
      onRelease: () => teleop.release(INPUT),
      onStop,
      onState: (state) => this.showState(state),
    });
    this.loop = new GamepadLoop({
      onFound: (device) => this.found(device),
      onSeen: (sample, at) => (this.learner ?? this.gamepad).see(sample, at),
      onOther: (index, sample, at) => this.others.get(index)?.see(sample, at),
      onLost: () => this.lost(),
      onAll: (all) => this.offer(all),
      rank: (device) => this.rank(device),
      mayChange: () => !this.learner && !this.gamepad.held && teleop.held.size === 0,
    });
    this.listen();
    this.show();
    this.showState("none");
    this.loop.listen(window);
  }

  // What is held must be pressed anew, as of teleop.js.
  drop() {
    this.gamepad.drop();
  }

  listen() {
    const on = (name, event, act) => this.part(name).addEventListener(event, act);
    const { least, most } = DEAD_ZONE;
    Object.assign(this.part("pad-dead-zone"), { min: least * 100, max: most * 100 });
    on("pad-learn", "click", () => this.learn());
    on("pad-pass", "click", () => this.learner?.pass());
    on("pad-cancel", "click", () => this.endLearning());
    on("pad-forget", "click", () => this.forget());
    on("pad-dead-zone", "input", ({ target }) => this.change({ deadZone: Number(target.value) / 100 }));
    on("pad-turbo", "input", ({ target }) => this.setTurbo(Number(target.value) / 100));
    for (const name of MOTIONS) on(`pad-invert-${name}`, "click", () => this.invert(name));
    on("pad-choice", "change", ({ target }) => {
      target.blur(); // else the drive keys would go on changing it
      this.loop.choose(Number(target.value));
      if (this.device) this.store.write(CHOICE, this.device.id);
    });
  }

  part(name) {
    return part(this.element, name);
  }

  found(device) {
    this.device = device;
    this.use(this.profileOf(device));
  }

  profileOf(device) {
    const stored = this.store.read(storedAs(device));
    return fits(stored, device) ? stored : usualProfile(device, this.kind);
  }

  // A device that can drive comes before one that cannot, as a keyboard that calls itself a gamepad; then the one that a
  // person chose at an earlier visit.
  rank(device) {
    return 2 * Number(this.profileOf(device) !== null) + Number(device.id === this.store.read(CHOICE));
  }

  lost() {
    this.endLearning();
    this.device = null;
    this.teleop.letGo();
    this.gamepad.forget();
    this.use(null);
    this.showState("lost");
  }

  use(profile) {
    this.profile = profile;
    this.gamepad.use(profile);
    this.show();
  }

  // By a person: kept for the next time that this device is here.
  keep(profile) {
    this.store.write(storedAs(this.device), profile);
    this.use(profile);
  }

  change(changes) {
    if (this.profile) this.keep({ ...this.profile, ...changes });
  }

  invert(name) {
    const motion = this.profile?.[name];
    if (motion) this.change({ [name]: { ...motion, invert: !motion.invert } });
  }

  // What is held goes on, with the new limit.
  setTurbo(share) {
    if (!this.profile) return;
    this.profile = { ...this.profile, turboShare: share };
    this.store.write(storedAs(this.device), this.profile);
    this.showTurbo();
  }

  showTurbo() {
    const { turboShare } = this.profile;
    const share = (this.limits.share = turboShare > 0 && turboShare <= 1 ? turboShare : 1);
    this.part("pad-turbo").value = share * 100;
    setText(this.part("pad-turbo-value"), texts.percent(share));
  }

  forget() {
    if (!this.device) return;
    this.endLearning();
    this.store.forget(storedAs(this.device));
    this.use(usualProfile(this.device, this.kind));
  }

  learn() {
    if (!this.device) return;
    this.teleop.letGo();
    this.gamepad.release();
    this.showState("learning");
    this.part("pad-learning").hidden = false; // first: what is hidden is not read out when it changes
    this.learner = new Learner({
      steps: stepsOf(this.kind),
      onAsk: (step, phase) => this.ask(step, phase),
      onDone: (learnt) => this.learnt(learnt),
    });
  }

  ask(step, phase) {
    setText(this.part("pad-ask"), texts.learning[phase](step));
    this.hide("pad-pass", phase !== "move" || !this.learner?.mayPass, "pad-cancel");
  }

  learnt(learnt) {
    const { device } = this;
    this.endLearning();
    this.keep(madeOf(learnt, device));
  }

  endLearning() {
    this.learner = null;
    this.hide("pad-learning", true, "pad-learn");
    setText(this.part("pad-ask"), "");
  }

  // The focus of a person at the keyboard moves on from a control that is gone.
  hide(name, hidden, next) {
    const element = this.part(name);
    const focused = element.contains(document.activeElement);
    element.hidden = hidden;
    if (hidden && focused) this.part(next).focus({ preventScroll: true });
  }

  offer(all) {
    this.others = new Map(all.filter(({ chosen }) => !chosen).map((device) => [device.index, this.other(device)]));
    const choice = this.part("pad-choice");
    choice.replaceChildren(...all.map(({ id, index, chosen }) => new Option(id, index, chosen, chosen)));
    this.part("pad-choices").hidden = all.length < 2;
  }

  // Its stop button counts; its enable button makes it the one that drives, from the next press on.
  other(device) {
    const onRefused = () => this.loop.takeUp(device.index);
    const other = new Gamepad({ accepts: () => false, onRefused, onStop: this.onStop, onState() {}, onHold() {}, onRelease() {} });
    other.use(this.profileOf(device));
    return other;
  }

  // Words change with what the person has to do, not with each push, so that a screen reader is not kept talking.
  showState(state) {
    if (this.shownState === state) return;
    this.shownState = this.element.dataset.state = state;
    const say = texts.gamepad[state] ?? texts.gamepad.ready; // also while it drives
    const words = say({ enable: this.name(this.profile?.enable) });
    setText(this.part("pad-state"), words);
    setText(this.trouble, TROUBLE.includes(state) ? words : "");
  }

  name(index) {
    return texts.button(index, this.device?.mapping === "standard");
  }

  show() {
    const { profile, device } = this;
    const uses = texts.gamepadUse;
    const optional = (index) => (index === null ? "" : this.name(index));
    const words = profile
      ? [uses.enable(this.name(profile.enable)), uses.turbo(optional(profile.turbo)), uses.stop(optional(profile.stop))]
      : [];
    if (profile && this.kind === "holonomic" && !profile.left) words.push(uses.left);
    setText(this.part("pad-use"), words.filter(Boolean).join(" "));
    setText(this.part("pad-name"), device?.id ?? "");
    this.part("pad-learn").disabled = !device;
    this.showSettings(profile);
    this.shownState = null; // the same state may need other words now
  }

  showSettings(profile) {
    this.part("pad-settings").hidden = !profile;
    if (!profile) return;
    this.part("pad-dead-zone").value = profile.deadZone * 100;
    setText(this.part("pad-dead-zone-value"), texts.percent(profile.deadZone));
    this.showTurbo();
    for (const name of MOTIONS) {
      const button = this.part(`pad-invert-${name}`);
      button.hidden = !profile[name];
      button.setAttribute("aria-pressed", String(Boolean(profile[name]?.invert)));
    }
  }
}
