// The drive page: one robot's connection, picture, speed and controls. Loaded by drive.html.

import { Banner } from "./banner.js";
import { Beats } from "./beats.js";
import { Commands } from "./commands.js";
import { Connection } from "./connection.js";
import { setUpControls } from "./controls.js";
import { Discovery } from "./discovery.js";
import { Feed } from "./feed.js";
import { openLink } from "./link.js";
import { ControlNews } from "./news.js";
import { localTime } from "./page.js";
import { Readback } from "./readback.js";
import { Readings } from "./readings.js";
import { RttMeter } from "./rtt.js";
import { Seat } from "./seat.js";
import { driveSettings } from "./settings.js";
import { StopBar } from "./stopbar.js";
import { requestTicket } from "./tickets.js";
import { View } from "./view.js";
import { Wheel } from "./wheel.js";

const BACKLOG_BYTES = 2048; // about half a second of drive commands
const SILENCE_MS = 2000; // the robot answers each second; what is sent into silence arrives late

const root = document.querySelector("main.drive");
const { robot, level, user } = root.dataset;
const settings = JSON.parse(root.dataset.settings);
const { driveTopic, ...limits } = driveSettings(settings);
const facts = { driving: false, armed: false, since: "" };

const beats = new Beats();
const seat = new Seat({ me: user, level, onMove: () => connection.reopen(), onChange: showSeat });
const discovery = new Discovery({ driveTopic, onFound: useTopics });
const connection = new Connection({
  requestTicket: () => requestTicket(robot, seat.mode),
  openLink,
  prepare: (call) => discovery.run(call),
  onState: showState,
  onLeaving: () => controls.letGo(), // a cut network may yet deliver the link's last commands
  onLink: (tell) => (tell ? beats.start(tell) : forgetLink()),
  onOwn: hearRelay,
});

const banner = new Banner(root, { onRetry: () => connection.retryNow({ asked: true }) });
const readings = new Readings(root);
const view = new View(root, { robot, settings });
const commands = new Commands({
  topic: driveTopic,
  advertise: (spec) => connection.advertise(spec),
  stamp: (moment) => beats.stamp(moment),
});
const rtt = new RttMeter({
  call: (service, request) => connection.call(service, request),
  onReading: (reading) => readings.rtt(reading),
});
const readback = new Readback({
  subscribe: (spec, handler) => connection.subscribe(spec, handler),
  onSpeed: (speed) => readings.speed(speed),
});
const controls = seat.mayDrive
  ? setUpControls(root, controlOptions())
  : { arm() {}, letGo() {}, halt() {} };
const wheel = new Wheel(root, { robot, seat });
const stopBar = new StopBar(root, {
  robot,
  halt: () => controls.halt(),
  tell: () => connection.tell({ op: "robotether.stop" }),
  onReleased: () => seat.drive("released"),
});
const news = new ControlNews({ onControl: useControl });
let armed = false;

function controlOptions() {
  return {
    limits,
    publish: (twist, moment) => commands.publish(twist, moment),
    mayQueue: () => connection.backlog < BACKLOG_BYTES && connection.silenceMs < SILENCE_MS,
    onWanted: (twist) => readings.wanted(twist),
  };
}

function hearRelay(message) {
  if (message.op === "robotether.beat") beats.hear(message);
  if (message.op === "robotether.control") news.fromLink(message.control);
}

function forgetLink() {
  beats.stop();
  news.linkEnded();
}

function useControl(control) {
  seat.hear(control);
  stopBar.hear(control.stopped);
}

function showState(state) {
  if (state.lost) seat.lose(state.lost, state.reason);
  const live = state.name === "live";
  commands.use(live && seat.driving);
  armed = false; // each new link needs new presses
  showSeat();
  if (live) {
    rtt.start();
    view.retryNow();
  } else {
    rtt.stop();
    discovery.stop();
    readback.forget();
  }
}

function showSeat() {
  const { live } = connection;
  Object.assign(facts, { driving: seat.driving, armed: seat.armed });
  banner.show(connection.state, facts);
  wheel.show(live);
  const arm = live && seat.driving && seat.armed;
  if (arm !== armed || !arm) controls.arm(arm);
  armed = arm;
}

function useTopics({ twistType, speed, cameras }) {
  commands.useType(twistType);
  if (speed) readback.follow(speed);
  view.found(cameras);
}

function useNews(robotNews) {
  const wasOnline = facts.online && facts.ros !== "down";
  const { online, ros, since, control } = robotNews;
  Object.assign(facts, { online, ros, since: online ? "" : localTime(since) });
  if (control) news.fromFeed(control);
  banner.show(connection.state, facts);
  if (!wasOnline && online && ros !== "down") retryNow();
}

function retryNow() {
  connection.retryNow();
  view.retryNow();
}

const feed = new Feed({
  onFleet: (all) => all.filter(({ name }) => name === robot).forEach(useNews),
  onRobot: (robotNews) => robotNews.name === robot && useNews(robotNews),
});

window.addEventListener("offline", () => connection.cut());
window.addEventListener("online", retryNow);
window.addEventListener("pagehide", () => {
  controls.arm(false);
  connection.stop();
});
window.addEventListener("pageshow", ({ persisted }) => persisted && location.reload());
connection.start();
view.start();
feed.start();
