// The drive page: one robot's connection, video, speed and controls. Loaded by drive.html.

import { framesUrl, requestTicket, rosUrl } from "../client/api.js";
import { GIVE_UP, RIGHTS_ENDED } from "../client/connection.js";
import { Feed } from "../client/feed.js";
import { FrameStream } from "../client/frames.js";
import { Session } from "../client/session.js";
import { Arming, NO_CONTROLS, VideoInterlock } from "../control/arming.js";
import { Banner, ControlPanel, isSlow, silenceOf } from "../control/controlPanel.js";
import { DriveMode, ReloadStore } from "../control/driveMode.js";
import { Summary } from "../control/driveSummary.js";
import { RecordButton } from "../control/recordButton.js";
import { Buttons } from "../control/robotButtons.js";
import { StopBar } from "../control/stopBar.js";
import { setUpControls } from "../input/controls.js";
import { AskForHelp } from "../queue/askForHelp.js";
import { Poller, tickWhileSeen } from "../queue/poller.js";
import { Readback, Readings } from "../overlays/readings.js";
import { SeenAge } from "../overlays/seenAge.js";
import { recorded, watchers } from "../texts/common.js";
import { Discovery } from "../topics/discovery.js";
import { Topics } from "../topics/topicList.js";
import { ObserverConnection } from "../topics/topicProbe.js";
import { TopicSwitch, Uplink } from "../topics/uplink.js";
import { View } from "../video/view.js";
import { LoginUse, api } from "../dom/calls.js";
import { Choices, FIELDS, asksForKeys, byTestId, localTime, matches, noteScript, part, reloadOnReturn, setText } from "../dom/page.js";
import { Presses } from "../dom/presses.js";
import { ScreenLock } from "../dom/screenLock.js";
import { driveSettings } from "./settings.js";

const CHECK_MS = 50;
const SILENCE_CHECK_MS = 250;
const HELP_EVERY_MS = 5000;

const root = document.body; // the header has a part in it, too
const main = /** @type {HTMLElement} */ (document.querySelector("main.drive"));
const { robot = "", mac = "", level = "observe", user = "" } = main.dataset;
const settings = JSON.parse(main.dataset.settings ?? "{}");
const odometryTopic = settings.page?.odometry_topic;
const { driveTopic, driveType, kind, wheelbase, limits, holdAfterMs, oldMs, maxAgeMs, isLimitedByAge } = driveSettings(settings);
const facts = { since: "", why: "", renamed: "", observers: 0, drivers: [""], silentS: 0, recording: false, unseen: false, isFed: false };

const loginUse = new LoginUse();
const screenLock = new ScreenLock();
const reloadStore = new ReloadStore(mac);
const driveMode = new DriveMode({
  me: user,
  level,
  drove: reloadStore.restore(),
  onMove: () => connection.reopen(driveMode.driving ? undefined : GIVE_UP),
  onChange: showDriveMode,
});
const interlock = new VideoInterlock({ afterMs: holdAfterMs, onChange: showDriveMode });
const discovery = new Discovery({ driveTopic, driveType, odometryTopic, onFound: useTopics });
const session = new Session({
  driveTopic,
  wheelbase,
  requestUrl: () => requestUrl(driveMode.mode),
  prepare: (call) => discovery.run(call),
  onState: showState,
  onLeaving: () => arming.leave(),
  onControl: useControl,
  onRoundTrip: showRoundTrip,
  seenAt,
  onSeen: (seen) => seenAge.receive(seen),
});
const { connection } = session;
const topicSwitch = new TopicSwitch({
  subscribe: (spec, handler) => connection.subscribe({ onUnread: () => view.failToRead(spec.name), ...spec }, handler),
  probes: { has: (name) => topics.probes.has(name), close: (name) => topics.closeProbe(name) },
});
const subscribe = (spec, handler) => topicSwitch.subscribe(spec, handler);

const banner = new Banner(root, { onRetry: () => connection.retryNow({ asked: true }), onBlind: () => interlock.allow() });
const readings = new Readings(root, { frameAge: () => interlock.ageMs, limits, oldMs });
const seenAge = new SeenAge(root);
const view = new View(root, {
  robot,
  mac,
  choices: new Choices(`sight.${mac}`), // another robot may get the name
  settings,
  driveTopic,
  oldMs,
  openFrames: (topic, options) => new FrameStream({ url: () => framesUrl(location.href, robot, topic, { mac }), ...options }),
  subscribe,
  onMain: (reading) => interlock.receive(reading),
});
const readback = new Readback({ subscribe, onSpeed: (speed) => readings.speed(speed), onPose: (pose) => view.world.receivePose(pose) });
const arming = new Arming({ interlock, output: session });
const controls = driveMode.mayDrive ? setUpControls(root, controlOptions()) : NO_CONTROLS;
arming.use(controls);
const controlPanel = new ControlPanel(root, { robot, mac, driveMode, driveTopic, isLimitedByAge, busy: () => controls.held() });
const stopBar = new StopBar(root, {
  robot,
  mac,
  halt: () => controls.halt(),
  send: (press) => session.stopRobot(press),
  onReleased: (again) => driveMode.released(again),
});
noteScript();
const topics = new Topics(part(root, "topics"), {
  observerConnection: new ObserverConnection({ requestUrl: () => requestUrl("observe") }),
  ask: () => discovery.refresh(),
});
new Uplink(part(root, "uplink"), {
  get: () => api.uplink(robot, mac),
  switches: { camera: view.tiles, topic: topicSwitch },
});
// Drivers have these.
const summary = driveMode.mayDrive ? new Summary(part(root, "summary"), { robot, mac, me: user }) : null;
const buttons = driveMode.mayDrive ? new Buttons(part(root, "buttons"), { buttons: settings.buttons ?? [], connection }) : null;
const recordButton = driveMode.mayDrive ? new RecordButton(root, { robot, mac, me: user, level, api }) : null;

const askForHelp = new AskForHelp(root, {
  robot,
  mac,
  me: user,
  level,
  post: (path, body) => api.post(path, body),
  onAsked: () => helpPoller.askNow(),
});
const helpPoller = new Poller({
  ask: () => api.get("/api/v1/requests", { state: "open", robot }),
  onAnswer: ({ requests }) => askForHelp.receive(requests),
  onState: ({ name }) => name !== "live" && askForHelp.receive(null),
  everyMs: HELP_EVERY_MS,
});

async function requestUrl(mode) {
  return rosUrl(location.href, robot, await requestTicket(api, robot, mode, { mac }));
}

function controlOptions() {
  return {
    kind,
    limits,
    choices: new Choices(`controls.${mac}`),
    output: arming,
    onTake: () => driveMode.press() || controls.letGo(),
    onWanted: useWanted,
    onStop: () => stopBar.press(),
  };
}

// What the server reads of the frames that the driver saw: none while a person drives without the main one, whatever
// the others show, so that the robot is at its slowest. One that is known to have no camera has nothing to name.
function seenAt(timestamp) {
  const seen = () => (interlock.kind === "blind" ? [] : view.tiles.seenAt(timestamp));
  const frames = view.mayHaveCamera ? seen() : null;
  facts.unseen ||= frames?.length === 0;
  seenAge.command(frames, timestamp);
  return frames?.map(({ topic: camera, sequence: frame }) => ({ camera, frame }));
}

// A gamepad's driver touches nothing that causes an event of the page.
function useWanted(twist) {
  if (Object.values(twist).some((value) => value !== 0)) loginUse.note();
  readings.wanted(twist);
}

function useControl(control) {
  if (session.controlState.linked) summary?.receive(control, driveMode.driving);
  driveMode.receive(control);
  stopBar.receive(control);
}

function showState(state) {
  noteEnd(state);
  const live = state.name === "live";
  session.use(live && driveMode.driving);
  screenLock.keep(live && driveMode.driving);
  if (!live && state.name !== "connecting") driveMode.settle();
  if (!driveMode.pressed) arming.disarm(); // each new link needs new presses, except the one that asked for it
  interlock.revoke();
  if (!live) facts.unseen = false;
  showDriveMode();
  useLink(live);
}

// What the end of a link says beyond the state.
function noteEnd(state) {
  if (state.lost) driveMode.lose(state.lost, state.reason);
  if (state.name === "not_allowed") endAll(state);
  if (state.code === RIGHTS_ENDED) controlPanel.outdated = true;
}

function useLink(live) {
  if (live) {
    driveMode.settle();
    view.retryNow();
  } else {
    summary?.linkEnded();
    discovery.stop();
    readback.forget();
  }
}

// The banner says why; who drives and what the cameras see is no longer reported to this page.
function endAll({ login, gone }) {
  driveMode.end();
  byTestId(root, "control").hidden = true;
  stopBar.end();
  if (gone) leaveRobot();
  const why = gone ? "gone" : "rights_ended";
  view.refuse(login ? "login_missing" : why);
}

// Another robot may have got the name by which all of the menu asks.
function leaveRobot() {
  findRenamed();
  askForHelp.receive([]);
  for (const element of part(root, "drawer").querySelectorAll(":scope > :is(section, details)")) element.hidden = true;
}

// A robot that got another name keeps its MAC.
async function findRenamed() {
  const { body } = await api.get("/api/v1/robots");
  facts.renamed = body.robots?.find((other) => other.mac === mac)?.name ?? "";
  showBanner();
}

function showDriveMode() {
  const { live } = connection;
  showBanner();
  controlPanel.show(connection);
  const { driving, armed, pressed, mayDrive, free } = driveMode;
  for (const panel of [topics, summary, buttons]) panel?.use({ live, driving });
  const watches = mayDrive && (pressed || (live && !driving));
  arming.update({ mayMove: live && driving && armed, watches, free });
}

function showBanner() {
  const { driving, armed, control, free, mayDrive } = driveMode;
  const stopped = control.stopped && { ...control.stopped, at: localTime(control.stopped.at) };
  const drive = { driving, armed, control, stopped, mayDrive, free, again: driveMode.wasStopped };
  banner.show(connection.state, { ...facts, ...drive, video: interlock.kind, hasCamera: view.hasCamera });
  setText(byTestId(root, "recording"), recorded(connection.live ? facts.recording : Boolean(facts.recording), Boolean(control.driver)));
  setText(byTestId(root, "watchers"), session.controlState.linked ? watchers(others()) : "");
  stopBar.offer(driveMode.wasStopped ? "again" : "idle");
  stopBar.know(session.controlState.linked || facts.isFed);
}

// All who watch but this page's own user, whom the server counts, too, while the link stands, except while that user drives.
const others = () => facts.observers - Number(!facts.drivers.includes(user));

function showRoundTrip(reading) {
  const parts = { server: session.clockSync.roundTripMs, robot: facts.rttMs };
  readings.rtt(reading, parts);
  facts.slow = isSlow(parts, maxAgeMs);
  showBanner();
}

function useTopics({ twistType, speed, topics: all, own, others, answered }) {
  session.useType(twistType);
  controls.useType(session.type);
  if (speed || answered) readback.follow(speed);
  view.found(own, answered, others);
  reopenUnlimited();
  topics.receive(all);
}

// On a connection that has named frames, the robot stays at its slowest without any.
function reopenUnlimited() {
  if (connection.live && facts.unseen && !view.mayHaveCamera && !controls.held()) connection.reopen();
}

function receiveRobot(update) {
  const wasOnline = facts.online && facts.ros !== "down";
  const { state, online, offline_reason: why, ros, since, control, rtt_ms: rttMs, observers, drivers } = update;
  Object.assign(facts, { online, ros, rttMs, observers, drivers, isFed: true });
  Object.assign(facts, { since: online ? "" : localTime(since), why: why ?? "", disabled: state === "disabled" });
  receiveRecording(Boolean(update.recording));
  view.overlays.showBattery(update);
  if (control) session.controlState.fromFeed(control);
  showBanner();
  if (!wasOnline && online && ros !== "down") retryNow();
}

// The banner says so.
function receiveRecording(recording) {
  facts.recording = recording;
  recordButton?.receive(recording);
}

function checkSilence() {
  const silentS = connection.live ? silenceOf(session.clockSync.silenceMs, interlock.ageMs) : 0;
  if (silentS === facts.silentS) return;
  facts.silentS = silentS;
  showBanner();
}

function retryNow() {
  connection.retryNow();
  view.retryNow();
}

// Another robot may get the name. A page that has no robot any more stays as it is.
const isOfPage = (update) => update.name === robot && update.mac === mac && !connection.state.gone;
const feed = new Feed({
  onFleet: (all) => all.filter(isOfPage).forEach(receiveRobot),
  onRobot: (update) => isOfPage(update) && receiveRobot(update),
  onState: (state) => ["lost", "login"].includes(state) && forgetRobot(),
});

// What the events alone report is unknown without them.
function forgetRobot() {
  Object.assign(facts, { rttMs: null, observers: 0, isFed: false });
  receiveRecording(null);
  view.overlays.showBattery({ online: false });
  showBanner();
}

// All that is rarely needed. It is left by its button and by Esc, which a field in it takes first.
function setUpDrawer() {
  const [drawer, opener] = [part(root, "drawer"), part(root, "drawer-open")];
  const open = (opened) => {
    drawer.hidden = !opened;
    main.dataset.drawer = String(opened);
    opener.setAttribute("aria-expanded", String(opened));
    (opened ? drawer : opener).focus({ preventScroll: true });
  };
  opener.addEventListener("click", () => open(drawer.hidden));
  window.addEventListener("keydown", (event) => {
    const { code, target } = event;
    if (code === "Escape" && !drawer.hidden && !matches(target, FIELDS)) open(false);
    if (asksForKeys(event)) showKeys(open);
  });
}

// An observer has none.
function showKeys(open) {
  const keys = part(root, "keys");
  if (!keys) return;
  open(true);
  keys.open = true;
  keys.scrollIntoView();
}

setUpDrawer();
new Presses().watch(window);
loginUse.watch(window);
window.addEventListener("offline", () => connection.cut());
window.addEventListener("online", retryNow);
window.addEventListener("pagehide", () => {
  reloadStore.save(driveMode.saved);
  arming.disarm();
  session.stop();
});
reloadOnReturn();
setInterval(() => interlock.check(), CHECK_MS);
setInterval(checkSilence, SILENCE_CHECK_MS);
tickWhileSeen(() => connection.state.gone || helpPoller.tick());
connection.start();
view.start();
feed.start();
