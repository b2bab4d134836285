// The page that plays a recording back. Loaded by recording.html.

import { LoginUse } from "../dom/calls.js";
import { TYPING, make, makeButton, matches, noteScript, part, setText } from "../dom/page.js";
import { COMMANDS, CONTROL, DriveState, ROUND_TRIPS, SEEN_AGES, historyOf, knownControl } from "../replay/driveState.js";
import { MapOfDrive } from "../replay/mapOfDrive.js";
import { ReplayVideo, camerasOf, frameOf } from "../replay/replayVideo.js";
import { Player } from "../replay/player.js";
import { BrokenFileError, RangeFile, RangeFileError } from "../replay/rangeFile.js";
import { RecordingReader } from "../replay/recordingReader.js";
import { Timeline, keyTarget } from "../replay/timeline.js";
import { clockText, replay as texts } from "../texts/replay.js";

const PRESSED_BY_SPACE = "button, a, summary, [type=checkbox]";
const OWN = [COMMANDS, SEEN_AGES, ROUND_TRIPS];
const MAX_CONTROLS = 2000; // changes of who drives that are read when the page is opened
const MAX_TRANSFORMS = 200; // messages of transforms that count at once
const MAX_AGE_MS = 3600_000; // of a frame, by the robot's clock
const WORDS_EVERY_MS = 200; // numbers that change with each frame nobody can read

class ReplayPage {
  // `controls` as of readControls; `driveTopic` may be empty; `named` as of mapOfDrive.js, with `cameras`.
  constructor(root, reader, { goesOn, controls, driveTopic, named }) {
    this.root = root;
    this.reader = reader;
    this.goesOn = goesOn;
    this.state = new DriveState();
    this.controls = controls;
    this.cameras = camerasOf(reader.topics, named.cameras ?? []);
    this.camera = this.cameras[0] ?? null;
    this.recorded = reader.spans();
    this.history = historyOf(controls, this.recorded);
    this.video = new ReplayVideo(part(root, "video"));
    this.wordsAt = 0;
    this.map = new MapOfDrive(part(root, "map"), {
      topics: reader.topics,
      driveTopic,
      named,
      onMeasured: (measured, atMs) => this.state.receive("measured", measured, atMs),
    });
    this.player = new Player({
      reader,
      topics: this.wanted,
      onReset: (messages) => this.reset(messages),
      onMessages: (messages) => this.receive(messages),
      onState: () => this.showState(),
    });
    this.timeline = new Timeline(root, { durationMs: reader.durationMs, onSeek: (atMs) => this.player.seek(atMs) });
  }

  start() {
    this.showEvents();
    this.showCameras();
    this.listen();
    this.player.seek(0);
    const tick = () => {
      this.player.tick();
      this.show();
      requestAnimationFrame(tick);
    };
    tick();
  }

  get wanted() {
    const { recent, newest, fixed } = this.map.wanted;
    const isKey = (message) => frameOf(this.reader.decode(message), message.atMs)?.isKey ?? false;
    return { recent: [...OWN, ...recent], newest, fixed, frames: this.camera?.topics ?? [], isKey };
  }

  // Those of a camera that changes its codec come as one.
  reset(messages) {
    this.state.reset();
    this.map.reset();
    this.video.reset([]);
    this.receive(messages);
    this.wordsAt = 0;
  }

  receive(messages) {
    const frames = [];
    for (const recorded of this.newestOnly(messages)) {
      const message = this.reader.decode(recorded);
      if (!message) continue;
      if (this.camera?.topics.includes(recorded.topic)) frames.push(this.noteFrame(recorded, message));
      else if (OWN.includes(recorded.topic)) this.state.receive(recorded.topic, message, recorded.atMs);
      else this.map.receive(recorded.topic, message, recorded.atMs);
    }
    this.video.push(frames.filter(Boolean));
  }

  // Of what says what is the case the newest is enough, however many messages a robot sent at once.
  newestOnly(messages) {
    const counts = new Map();
    const kept = [...messages].reverse().filter(({ topic }) => {
      const count = (counts.get(topic) ?? 0) + 1;
      counts.set(topic, count);
      return count <= this.mostOf(topic);
    });
    return kept.reverse();
  }

  mostOf(topic) {
    if (this.camera?.topics.includes(topic)) return Infinity;
    return this.map.isMadeOfMany(topic) ? MAX_TRANSFORMS : 1;
  }

  noteFrame(recorded, message) {
    const { ageMs, atMs } = recorded;
    this.state.receive("frame", { ageMs: ageMs >= 0 && ageMs < MAX_AGE_MS ? ageMs : null }, atMs);
    return frameOf(message, atMs);
  }

  listen() {
    const { player } = this;
    part(this.root, "play").addEventListener("click", () => this.toggle());
    part(this.root, "speed").addEventListener("change", ({ target }) => (player.speed = Number(target.value)));
    part(this.root, "camera").addEventListener("change", ({ target }) => {
      this.camera = this.cameras[Number(target.value)];
      this.useCamera();
    });
    window.addEventListener("keydown", (event) => this.press(event));
    document.addEventListener("visibilitychange", () => document.hidden && player.pause());
  }

  toggle() {
    if (this.player.playing) this.player.pause();
    else this.player.play();
  }

  // What is focused keeps its own keys, but the slider has those of the page.
  press(event) {
    const { key, target, ctrlKey, metaKey, altKey } = event;
    if (ctrlKey || metaKey || altKey || matches(target, TYPING)) return;
    const to = keyTarget(event, this.player.atMs, this.player.durationMs);
    if (key === " " && !matches(target, PRESSED_BY_SPACE)) this.toggle();
    else if (to !== undefined) this.player.seek(to);
    else return;
    event.preventDefault();
  }

  showCameras() {
    const select = part(this.root, "camera");
    select.replaceChildren(...this.cameras.map(({ name }, i) => make("option", { value: String(i) }, name)));
    part(this.root, "cameras").hidden = this.cameras.length < 2;
    this.useCamera(false);
  }

  useCamera(seeks = true) {
    const canvas = part(part(this.root, "video"), "canvas");
    canvas.setAttribute("aria-label", this.camera ? texts.of(this.camera.name) : texts.noVideo);
    this.timeline.use({ video: this.reader.spans(this.camera?.topics ?? []), drives: this.history.drives, stops: this.history.stops });
    if (seeks) this.player.use(this.wanted);
  }

  showEvents() {
    const { events, isMore } = this.history;
    const list = events.map(({ atMs, text }) => {
      const button = makeButton("event", "", () => this.player.seek(atMs));
      button.append(make("span", { class: "amount" }, clockText(atMs)), ` ${text}`);
      return make("li", {}, button);
    });
    part(this.root, "events").replaceChildren(...list);
    const none = this.controls.length ? texts.noEvents : texts.unknownEvents;
    setText(part(this.root, "no-events"), isMore ? texts.moreEvents(events.length) : list.length ? "" : none);
  }

  isRecordedAt(atMs) {
    return this.recorded.some(({ fromMs, toMs }) => atMs >= fromMs && atMs <= toMs);
  }

  controlAt(atMs) {
    return this.controls.reduce((newest, each) => (each.atMs <= atMs ? each : newest), { message: null }).message;
  }

  show() {
    const { atMs, loading } = this.player;
    this.timeline.show(atMs);
    this.video.show(atMs, { isRecorded: Boolean(this.camera), loading });
    const now = performance.now();
    if (now - this.wordsAt < WORDS_EVERY_MS) return;
    this.wordsAt = now;
    this.map.show(atMs);
    const control = this.isRecordedAt(atMs) ? this.controlAt(atMs) : null;
    const words = this.state.words(atMs, control);
    for (const [name, text] of Object.entries(words)) {
      const element = part(this.root, `value-${name}`);
      setText(element, text);
      element.dataset.recorded = String(text !== texts.notRecorded);
    }
    part(this.root, "values").dataset.stopped = String(Boolean(control?.stopped));
    showNotice(this.root, this.notices.join(" "));
  }

  showState() {
    const { playing, error } = this.player;
    const button = part(this.root, "play");
    setText(part(button, "words"), playing ? texts.pause : texts.play);
    button.dataset.playing = String(playing);
    this.root.dataset.playing = String(playing);
    showProblem(this.root, error);
  }

  get notices() {
    const { isWhole, isCut, left, damages, unreadable } = this.reader;
    const unfinished = this.goesOn ? texts.goesOn : texts.unfinished;
    return [
      !isWhole && unfinished,
      isCut && texts.cut,
      left && texts.otherTimes,
      damages && texts.damaged,
      unreadable && texts.unreadable,
    ].filter(Boolean);
  }
}

function showNotice(root, words) {
  const notice = part(root, "notice");
  setText(notice, words);
  notice.hidden = !words;
}

// What was shown stays.
function showProblem(root, error) {
  const problem = part(root, "problem");
  problem.hidden = !error;
  setText(part(problem, "words"), error ? problemText(error) : "");
}

function problemText(error) {
  return error instanceof RangeFileError ? texts.failed(error.status, error.detail) : texts.noRecording;
}

// From one that cannot be read, or is not, nobody knows who drives.
async function readControls(reader) {
  const controls = [];
  for await (const recorded of reader.messages({ topics: [CONTROL] })) {
    const isMore = controls.length >= MAX_CONTROLS;
    controls.push({ atMs: recorded.atMs, message: isMore ? null : knownControl(reader.decode(recorded)), isMore });
    if (isMore) break;
  }
  return controls;
}

// As the first command names it.
async function readDriveTopic(reader) {
  for await (const recorded of reader.messages({ topics: [COMMANDS] })) return reader.decode(recorded)?.topic ?? "";
  return "";
}

async function open(root) {
  const { file = "", state = "", topics = "{}" } = root.dataset;
  part(root, "problem").hidden = true;
  showNotice(root, texts.opening);
  try {
    const reader = await RecordingReader.open(await new RangeFile(file).open());
    if (!reader.chunks.length) return showNotice(root, texts.empty);
    const [controls, driveTopic] = [await readControls(reader), await readDriveTopic(reader)];
    showNotice(root, "");
    part(root, "player").hidden = false;
    new ReplayPage(root, reader, { goesOn: state === "recording", controls, driveTopic, named: JSON.parse(topics) }).start();
  } catch (error) {
    showNotice(root, "");
    showProblem(root, error);
    if (!(error instanceof RangeFileError) && !(error instanceof BrokenFileError)) console.error(error);
  }
}

if (typeof document !== "undefined") {
  const root = /** @type {HTMLElement} */ (document.querySelector("[data-part=replay]"));
  part(root, "again").addEventListener("click", () => location.reload());
  new LoginUse().watch(window);
  noteScript();
  open(root);
}
