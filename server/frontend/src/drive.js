// The drive page: one robot's connection, picture, speed and controls. Loaded by drive.html.

import { Banner } from "./banner.js";
import { Connection } from "./connection.js";
import { setUpControls } from "./controls.js";
import { Discovery } from "./discovery.js";
import { Feed } from "./feed.js";
import { openLink } from "./link.js";
import { twistMessage } from "./messages.js";
import { localTime } from "./page.js";
import { Readback } from "./readback.js";
import { Readings } from "./readings.js";
import { RttMeter } from "./rtt.js";
import { requestTicket } from "./tickets.js";
import { View } from "./view.js";

const BACKLOG_BYTES = 2048; // about half a second of drive commands
const SILENCE_MS = 2000; // the robot answers each second; what is sent into silence arrives late

const root = document.querySelector("main.drive");
const { robot, level } = root.dataset;
const settings = JSON.parse(root.dataset.settings);
const driving = level !== "observe";
const driveTopic = settings.drive_topic || "/cmd_vel";
const facts = { driving, drivers: [], since: "" };

const discovery = new Discovery({ driveTopic, onFound: useTopics });
const connection = new Connection({
  requestTicket: () => requestTicket(robot, driving ? "drive" : "observe"),
  openLink,
  prepare: (call) => discovery.run(call),
  onState: showState,
  onLeaving: () => controls.letGo(), // a cut network may yet deliver the link's last commands
});

const banner = new Banner(root, { onRetry: () => connection.retryNow({ asked: true }) });
const readings = new Readings(root);
const view = new View(root, { robot, settings });
const rtt = new RttMeter({
  call: (service, request) => connection.call(service, request),
  onReading: (reading) => readings.rtt(reading),
});
const readback = new Readback({
  subscribe: (spec, handler) => connection.subscribe(spec, handler),
  onSpeed: (speed) => readings.speed(speed),
});
const drive = { type: null, publisher: null };
const controls = driving ? setUpControls(root, controlOptions()) : { arm() {}, letGo() {} };

function controlOptions() {
  return {
    settings,
    publish: (twist) => drive.publisher?.publish(twistMessage(drive.type, twist)),
    mayQueue: () => connection.backlog < BACKLOG_BYTES && connection.silenceMs < SILENCE_MS,
    onWanted: (twist) => readings.wanted(twist),
  };
}

function showState(state) {
  banner.show(state, facts);
  const live = state.name === "live";
  controls.arm(live);
  if (live) {
    rtt.start();
    view.retryNow();
  } else {
    rtt.stop();
    discovery.stop();
    readback.forget();
  }
}

function useTopics({ twistType, speed, cameras }) {
  if (driving) useDriveType(twistType);
  if (speed) readback.follow(speed);
  view.found(cameras);
}

function useDriveType(type) {
  if (type !== drive.type) {
    drive.publisher?.end();
    drive.type = type;
    drive.publisher = connection.advertise({ name: driveTopic, type });
  }
}

function useNews(news) {
  const wasOnline = facts.online && facts.ros !== "down";
  Object.assign(facts, news, {
    since: news.online ? "" : localTime(news.since),
    drivers: news.drivers ?? [],
  });
  banner.show(connection.state, facts);
  if (!wasOnline && news.online && news.ros !== "down") retryNow();
}

function retryNow() {
  connection.retryNow();
  view.retryNow();
}

const feed = new Feed({
  onFleet: (all) => all.filter(({ name }) => name === robot).forEach(useNews),
  onRobot: (news) => news.name === robot && useNews(news),
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
