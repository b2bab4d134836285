// Calls a person to an offer: by a sound, and by the page's title, which changes each second. Each can be switched off.

import { Choices } from "../dom/page.js";

const SOUND_EVERY = 2; // number of ticks from one sound to the next
const NOTES = [660, 880]; // Hz
const NOTE_S = 0.18;
const VOLUME = 0.2;

export class Alerts {
  /**
   * @param {{
   *   choices?: Choices, page?: {title: string}, sound?: {play: () => void, unlock: () => Promise<void>, isSilent: boolean},
   *   onChange?: () => void,
   * }} options
   */
  constructor({ choices = new Choices("queue.alerts"), page = document, sound = new Sound(), onChange = () => {} } = {}) {
    this.choices = choices;
    this.page = page;
    this.sound = sound;
    this.onChange = onChange;
    this.usualTitle = page.title;
    this.title = ""; // of the offer; empty without one
    this.ticks = 0;
  }

  // On until a person switches it off.
  isOn(name) {
    return this.choices.all[name] !== false;
  }

  async set(name, on) {
    this.choices.keep({ [name]: on });
    this.show();
    if (name === "sound" && on) await this.unlock();
    if (name === "sound" && on) this.sound.play();
  }

  // In the handler of a press: a browser plays nothing before a person has done something on the page.
  async unlock() {
    await this.sound.unlock();
    this.onChange();
  }

  // The title while something is offered, else "".
  offer(title) {
    if (title === this.title) return;
    this.title = title;
    this.ticks = 0;
    this.show();
    if (title) this.playIfOn();
  }

  // Each second.
  tick() {
    if (!this.title) return;
    this.ticks += 1;
    if (this.ticks % SOUND_EVERY === 0) this.playIfOn();
    this.show();
  }

  playIfOn() {
    if (this.isOn("sound")) this.sound.play();
  }

  show() {
    const blinks = this.title && this.isOn("title") && this.ticks % 2 === 0;
    this.page.title = blinks ? this.title : this.usualTitle;
    this.onChange();
  }

  get isSilenced() {
    return this.isOn("sound") && this.sound.isSilent;
  }
}

// Two short notes, made here: no file to load.
class Sound {
  /** @type {AudioContext | null} */
  context = null;

  get isSilent() {
    return this.context?.state !== "running";
  }

  async unlock() {
    try {
      this.context ??= new AudioContext();
      await this.context.resume();
    } catch {
      // No sound on this device: the page keeps saying that it plays none.
    }
  }

  play() {
    if (!this.isSilent) NOTES.forEach((hertz, place) => this.note(this.context, hertz, place * NOTE_S));
  }

  note(context, hertz, afterS) {
    const [tone, volume] = [context.createOscillator(), context.createGain()];
    const begin = context.currentTime + afterS;
    tone.frequency.value = hertz;
    volume.gain.setValueAtTime(VOLUME, begin);
    volume.gain.exponentialRampToValueAtTime(VOLUME / 100, begin + NOTE_S);
    tone.connect(volume).connect(context.destination);
    tone.start(begin);
    tone.stop(begin + NOTE_S);
  }
}
