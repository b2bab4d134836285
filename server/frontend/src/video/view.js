// The video of the drive page: which cameras, their layout, their quality, and how old the main one is.
// It must never say that a frame is fresher than it is: driving is paused by what it reports.

import { readRefusal, snapshotUrl } from "../client/api.js";
import { Sleep } from "../control/arming.js";
import { LaserRing } from "../overlays/laserRing.js";
import { MapTile } from "../overlays/mapTile.js";
import { Overlays } from "../overlays/overlays.js";
import { World } from "../overlays/world.js";
import { TEXT, byTestId, download, matches, part, setText } from "../dom/page.js";
import { video as texts } from "../texts/video.js";
import { cameraTopics, offeredCameras } from "../topics/discovery.js";
import { TopicChoice } from "../topics/ownTopics.js";
import { requestedQuality } from "./cameraTile.js";
import { Layout, MAP } from "./layout.js";
import { NUMBER_KEYS, SourceButtons } from "./sourceButtons.js";
import { Tiles } from "./tiles.js";

const CHECK_MS = 100;
const SHOW_EVERY = 2; // of these
const NOTE_MS = 6000;
const SETTLE_MS = 300;
const ROOM_FOR_MAP = "(min-width: 600px) and (min-height: 700px), (max-width: 599px) and (min-height: 800px)"; // as of drive-deck.css

export class View {
  // `choices` as of page.js, of this robot's view; `driveTopic` and `oldMs` as of settings.js;
  // `openFrames(topic, {request, onFrame, onStatus})` gives a stream as of client/frames.js; `subscribe` as of connection.js;
  // `onMain({offered, at})` reports the main frame as of VideoInterlock, ten times a second and at each frame.
  constructor(root, { robot, mac, choices, settings, driveTopic, oldMs, openFrames, subscribe, onMain, now = () => performance.now() }) {
    this.root = root;
    this.robot = robot;
    this.mac = mac;
    this.now = now;
    this.page = settings.page ?? {};
    this.choice = new TopicChoice({ named: (kind) => this.page[`${kind}_topic`], driveTopic });
    this.others = []; // names of topics that are another robot's
    this.element = byTestId(root, "view");
    this.choices = choices;
    this.layout = new Layout(this.choices.group("layout"));
    this.known = new Set(); // topics of cameras; one whose node has died is a missing frame, not a robot without a camera
    this.answered = false; // whether the robot has said which topics it has
    this.lostCamera = false; // whether a known camera turned out to be another robot's
    this.questions = [];
    this.unread = new Set(); // topics
    this.mainTimestamp = new MainTimestamp();
    this.sleep = new Sleep();
    this.onMain = onMain;
    this.refused = null;
    /** @type {import("../topics/discovery.js").Camera[]} */
    this.cameras = [];
    this.hasMap = false;
    this.usualIsDown = this.saysNone = this.page.video === "none"; // by its manager; a camera that is found counts all the same
    this.ticks = 0;
    this.tools = this.findTools();
    this.sourceButtons = new SourceButtons(part(root, "sources"), { onChoose: (id) => this.choose(id) });
    this.world = new World({ subscribe, onChange: () => this.drawMaps(), onMapRefused: (why) => this.note(texts.mapRefused(why)), now });
    this.smallMap = new MapTile(part(root, "small-map"), { world: this.world, memory: () => this.choices.group("map"), small: true });
    this.roomForMap = matchMedia(ROOM_FOR_MAP);
    this.overlays = new Overlays(root, { subscribe, now });
    const ring = part(root, "laser-ring"); // drivers have one
    this.ring = ring && new LaserRing(ring, this.world);
    this.tiles = new Tiles(part(this.element, "stage"), this.tileOptions(openFrames, oldMs));
    this.setUpTools();
    this.listen();
  }

  tileOptions(openFrames, oldMs) {
    return {
      openFrames,
      common: () => this.commonRequest(),
      set: { width: this.page.width ?? null, height: this.page.height ?? null },
      oldMs,
      world: this.world,
      memory: () => this.choices.group("map"),
      onMemory: (map) => this.choices.keep({ map }),
      onPainted: (topic) => this.seen(topic),
      onDown: () => this.lacks(),
      onChoose: (id) => this.choose(id),
      now: this.now,
    };
  }

  start() {
    this.offer();
    setInterval(() => this.tick(), CHECK_MS);
  }

  // `topics` are all of this robot's, {name, type}; `answered` and `others` as of discovery.js.
  found(topics, answered, others = []) {
    Object.assign(this, { answered, others });
    cameraTopics(topics).forEach((topic) => this.known.add(topic));
    others.forEach((topic) => this.known.delete(topic) && (this.lostCamera = true));
    const { chosen, inDoubt, left } = this.choice.choose(topics, others);
    const asked = inDoubt.filter(({ kind }) => kind !== "turtle"); // it counts only without odometry
    this.questions = asked.map(({ kind, candidates }) => texts.topicInDoubt(kind, candidates));
    if (left.some((kind) => kind !== "diagnostics")) this.world.forget();
    if (left.includes("diagnostics")) this.overlays.forget();
    this.world.follow(chosen);
    this.overlays.follow(chosen);
    this.hasMap = Boolean(this.hasMap || chosen.scan || chosen.map || chosen.odometry);
    this.showQuestions();
    this.offer();
  }

  // A message of this topic cannot be read; said once.
  failToRead(topic) {
    this.unread.add(topic);
    this.showQuestions();
  }

  // Of topics that fit equally well none is shown: whoever manages the robot chooses.
  showQuestions() {
    const words = [...this.questions, ...[...this.unread].map(texts.unread)].join(" ");
    const element = part(this.root, "topic-questions");
    if (words && words !== element.textContent) this.note(words);
    setText(element, words);
  }

  // No frame comes to this page any more; `why` as of texts/video.js.
  refuse(why) {
    this.refused = why;
    this.arrange();
  }

  retryNow() {
    this.tiles.each((tile) => tile.retryNow());
  }

  // A robot that reports no camera may have the usual one all the same.
  seen(topic) {
    if (!this.others.includes(topic)) this.known.add(topic);
    this.layout.keep(topic);
    this.reportMain();
  }

  // What a robot that reports no camera is asked for gives nothing: it has none, and its map takes the place.
  lacks() {
    if (this.usualIsDown || this.hasCamera) return;
    this.usualIsDown = true;
    this.offer();
  }

  get hasCamera() {
    return Boolean(this.page.cameras?.length) || this.known.size > 0;
  }

  // One that has not said so is not without a camera, nor is one whose driver went by another robot's.
  get mayHaveCamera() {
    return this.hasCamera || !(this.saysNone || (this.answered && !this.lostCamera));
  }

  offer() {
    const { page, known, hasMap, hasCamera, usualIsDown } = this;
    const { wanted } = this.layout;
    const guess = wanted === MAP || this.others.includes(wanted) ? null : wanted;
    this.cameras = usualIsDown && hasMap && !hasCamera ? [] : offeredCameras({ configured: page.cameras, known: [...known], guess });
    const ids = this.cameras.map(({ topic }) => topic);
    this.layout.offer(hasMap ? [...ids, MAP] : ids);
    this.offerSources();
    this.arrange();
  }

  offerSources() {
    const sources = this.cameras.map(({ topic, name }) => ({ id: topic, name }));
    if (this.hasMap) sources.push({ id: MAP, name: texts.map });
    this.sourceButtons.offer(sources);
    this.tools.layout.disabled = sources.length < 2;
  }

  findTools() {
    const names = ["layout", "quality", "turn", "still", "full", "laser"];
    return Object.fromEntries(names.map((name) => [name, part(this.root, name)]));
  }

  setUpTools() {
    const { layout, quality, full, laser } = this.tools;
    layout.value = this.layout.kind;
    const { all: chosen } = this.choices;
    if ([...quality.options].some(({ value }) => value === chosen.quality)) quality.value = chosen.quality;
    full.hidden = !mayBeFull();
    if (!this.ring) return;
    laser.checked = Boolean(chosen.laser);
    this.ring.show(laser.checked);
  }

  listen() {
    const { layout, quality, turn, still, full, laser } = this.tools;
    onChoice(layout, (kind) => this.change(() => this.layout.use(kind)));
    onChoice(quality, (value) => {
      this.choices.keep({ quality: value });
      this.tiles.each((tile) => tile.ask());
    });
    laser?.addEventListener("change", () => {
      this.choices.keep({ laser: laser.checked });
      this.ring?.show(laser.checked);
    });
    turn.addEventListener("click", () => this.change(() => this.layout.turn(this.layout.main)));
    still.addEventListener("click", () => this.saveSnapshot());
    full.addEventListener("click", toggleFull);
    window.addEventListener("keydown", (event) => this.press(event));
    document.addEventListener("visibilitychange", () => this.arrange());
    this.roomForMap.addEventListener("change", () => this.arrange());
    part(this.smallMap.element, "enlarge").addEventListener("click", () => this.choose(MAP));
    new ResizeObserver(() => this.resized()).observe(part(this.element, "stage"));
  }

  press(event) {
    const action = viewActionOf(event);
    if (!action) return;
    event.preventDefault(); // a menu that has the focus would look for the letter
    if (action.fullscreen) toggleFull();
    else this.change(() => (action.next ? this.layout.next() : this.layout.nth(action.nth)));
  }

  choose(id) {
    this.change(() => this.layout.choose(id));
  }

  change(act) {
    act();
    this.choices.keep({ layout: this.layout.memory });
    this.arrange();
  }

  resized() {
    clearTimeout(this.settling);
    this.settling = setTimeout(() => this.tiles.each((tile) => tile.ask()), SETTLE_MS);
  }

  commonRequest() {
    const { fps = 15, latency_ms = 300 } = this.page;
    return { ...requestedQuality(this.tools.quality.value, this.page), fps, latency_ms };
  }

  // Beside the stick, where there is room and the map has no place in the video.
  get showsSmallMap() {
    return this.hasMap && this.roomForMap.matches && !document.hidden && !this.refused && !this.layout.shown.includes(MAP);
  }

  drawMaps() {
    this.tiles.get(MAP)?.draw();
    this.smallMap.draw();
    this.ring?.draw();
  }

  arrange() {
    const { layout, tools } = this;
    if (!this.showsSmallMap) this.smallMap.stop(); // before the large one begins: they share what is subscribed to
    const turned = ({ topic, turned_deg }) => layout.turned(topic, turned_deg);
    this.tiles.arrange({
      kind: layout.arranged,
      main: layout.main,
      shown: layout.shown.map((id) => this.cameras.find(({ topic }) => topic === id) ?? { topic: id, name: texts.map }),
      turned,
      playing: !document.hidden && !this.refused,
      why: this.refused ?? "paused",
    });
    this.sourceButtons.show(layout.main);
    tools.turn.disabled = tools.still.disabled = layout.main === MAP;
    this.placeSmallMap();
    this.reportMain();
  }

  // Its place stays while the map is in the video, or what stands below would move.
  placeSmallMap() {
    const { smallMap, showsSmallMap } = this;
    smallMap.element.hidden = !this.hasMap || !this.roomForMap.matches;
    smallMap.element.dataset.shown = String(showsSmallMap);
    if (showsSmallMap) smallMap.start();
  }

  // What the driver goes by: the main frame, or beside the map the first camera that is shown.
  get watched() {
    const cameras = this.layout.shown.filter((id) => id !== MAP);
    return cameras.includes(this.layout.main) ? this.layout.main : (cameras[0] ?? null);
  }

  reportMain() {
    const { watched } = this;
    if (this.sleep.isOver(this.now(), Date.now())) this.forget();
    const at = this.mainTimestamp.read(watched, this.tiles.get(watched)?.at ?? null);
    this.onMain({ offered: this.mayHaveCamera && !document.hidden, at });
  }

  forget() {
    this.mainTimestamp = new MainTimestamp();
    this.tiles.forget();
  }

  tick() {
    this.reportMain();
    this.ticks += 1;
    if (this.ticks % SHOW_EVERY !== 0) return;
    this.tiles.each((tile) => tile.showState());
    this.smallMap.showState();
    this.ring?.draw(); // without the points of a scan that has grown old
    this.overlays.show();
  }

  async saveSnapshot() {
    const camera = this.cameras.find(({ topic }) => topic === this.layout.main);
    if (!camera) return;
    this.note(await saveSnapshot(this.robot, this.mac, camera));
  }

  note(text) {
    const note = part(this.root, "sight-note");
    setText(note, text);
    clearTimeout(this.noting);
    this.noting = setTimeout(() => setText(note, ""), NOTE_MS);
  }
}

// The timestamp of what is in the main place. Another camera that is put there begins with the timestamp of the one before, as the
// driver has seen that much; from its own first frame on it answers for itself.
export class MainTimestamp {
  constructor() {
    this.id = null;
    this.before = null;
  }

  // `at` is the timestamp of the newest frame of the source `id`, null before its first.
  read(id, at) {
    if (id !== this.id) {
      this.before = this.newest ?? null;
      this.id = id;
    }
    this.newest = at ?? this.before;
    return this.newest;
  }
}

function onChoice(choice, act) {
  choice.addEventListener("change", () => {
    choice.blur(); // else the drive keys would go on changing it
    act(choice.value);
  });
}

// The whole page in fullscreen: the video alone would leave stick, Stop and status behind. Older Safari has names of its own.
const safari = () => /** @type {any} */ (document);
const page = () => /** @type {any} */ (document.documentElement);

const mayBeFull = () => Boolean(page().requestFullscreen ?? page().webkitRequestFullscreen);

const isFull = () => Boolean(document.fullscreenElement ?? safari().webkitFullscreenElement);

// Refused when no key or click is behind it; then the page stays as it is.
async function toggleFull() {
  const act = isFull()
    ? (document.exitFullscreen ?? safari().webkitExitFullscreen).bind(document)
    : (page().requestFullscreen ?? page().webkitRequestFullscreen)?.bind(page());
  try {
    await act?.();
  } catch {
    return;
  }
}

// The keys of the video: C the next source, 1 to 4 one of them, F fullscreen. By their place on the keyboard, as the keys
// that drive, which they must never be.

// Gives the action that a key asks for: {next}, {nth: 0..3}, {fullscreen}, or null.
export function viewActionOf(event) {
  if (isMeantForOthers(event)) return null;
  const { code } = event;
  if (code === "KeyC") return { next: true };
  if (code === "KeyF") return { fullscreen: true };
  const number = Number(/^(?:Digit|Numpad)(\d)$/.exec(code)?.[1]);
  return number >= 1 && number <= NUMBER_KEYS ? { nth: number - 1 } : null;
}

const isMeantForOthers = ({ repeat, ctrlKey, altKey, metaKey, target }) => repeat || ctrlKey || altKey || metaKey || matches(target, TEXT);

// A still at full quality, saved as a file.
const FULL_QUALITY = 100;

// robot-camera-20260101T120304Z.jpg; a camera's name may have what no file name may.
function snapshotName(robot, camera, time) {
  const plain = camera.replace(/[^A-Za-z0-9]+/g, "-").replace(/^-|-$/g, "") || "camera";
  return `${robot}-${plain}-${time.toISOString().replace(/[-:]|\.\d+/g, "")}.jpg`;
}

// Gives the words for how it went.
async function saveSnapshot(robot, mac, { topic, name }) {
  const answer = await fetch(snapshotUrl(robot, { topic, quality: FULL_QUALITY, mac }), { cache: "no-store" }).catch(() => null);
  const isImage = answer?.ok && answer.headers.get("Content-Type")?.startsWith("image/");
  const image = isImage && (await answer.blob().catch(() => null));
  if (!image) return refusalWords(answer);
  download(image, snapshotName(robot, name, new Date()));
  return texts.snapshotSaved;
}

async function refusalWords(answer) {
  const { status, detail } = answer ? await readRefusal(answer) : { status: 0, detail: "" };
  return texts.snapshotFailed(status, detail);
}
