// What is said of a robot on the fleet page, and where: the markup is the server's (_robot_card.html), a card or a row of
// the table; here it is only filled in.

import { ReloadStore } from "../control/driveMode.js";
import { cloned } from "../dom/keyedRows.js";
import { part, setIfOther, setText, localTime, utcTimestamp } from "../dom/page.js";
import { batteryText, isLow } from "../overlays/battery.js";
import { stop as stopTexts } from "../texts/common.js";
import { fleet as texts } from "../texts/fleet.js";

// What is hovered of a card, whose link covers its text, and of a row.
const HOVERED = { card: ["name"], row: ["presence", "stopped-row"] };
const MAY_BE_CUT = { card: ["drivers", "site"], row: ["name", "drivers", "site"] };

// `written` gives a time as it is shown.
export function presenceText({ state, online, since }, written = localTime) {
  if (state === "pending") return texts.pending;
  if (state === "disabled") return texts.disabled;
  return online ? texts.online(written(since)) : texts.offline(written(since));
}

// Its times in UTC, as lists have them on hover.
// Why it is offline, too, which may be too long for its place.
function utcText(robot) {
  const { by, at } = robot.control?.stopped ?? {};
  const stopped = at && stopTexts.stopped({ by, at: utcTimestamp(at) });
  return [robot.since && presenceText(robot, utcTimestamp), stopped, !robot.online && robot.offline_reason].filter(Boolean).join("\n");
}

// A robot as the server wrote it into its card, until the events come.
export const robotOf = ({ robot, mac, state, online, since, site, offlineReason }) => ({
  name: robot,
  mac,
  state,
  online: online === "true",
  since,
  site: site || null,
  offline_reason: offlineReason,
});

// What keeps a robot from being used, or soon will.
export function attention({ online, offline_reason: reason, ros, video, battery, control }) {
  if (!online) return [reason || texts.offlineUnknown];
  const reasons = [
    ros === "down" && texts.ros,
    video === "down" && texts.video,
    control?.guard === "down" && texts.guard,
    isLow(battery) && texts.batteryLow,
  ];
  return reasons.filter(Boolean);
}

export const healthText = (robot) => attention(robot).join(", ");

// Who drives, or for whom the robot is reserved, and who asks for it.
export function driverText({ control }) {
  const { driver, reserved, waiting } = control ?? {};
  const name = driver?.user ?? (reserved ? texts.reservedFor(reserved.user) : "");
  return waiting && name ? texts.driverAsked(name, waiting.user) : name;
}

const isDriven = ({ control }) => Boolean(control?.driver);

// Makes a card or row out of the page's template for a robot that has none.
export function newCard(template, { name }) {
  const card = cloned(template);
  card.dataset.robot = name;
  card.dataset.testid = `robot-${card.dataset.kind}-${name}`;
  const link = part(card, "name");
  link.href = `/robots/${encodeURIComponent(name)}`;
  link.textContent = name;
  for (const act of ["drive", "watch"]) {
    part(card, act).href = link.href;
    setText(part(card, `${act}-name`), ` ${name}`);
  }
  return card;
}

// Drive is a request that the next page of this tab grants. What opens another tab is none.
export function offerDrive(card, mac) {
  part(card, "drive")?.addEventListener("click", ({ ctrlKey, metaKey, shiftKey, altKey }) => {
    if (!(ctrlKey || metaKey || shiftKey || altKey)) new ReloadStore(mac).save({ armed: true, asked: true });
  });
}

export function fillCard(card, robot) {
  fillData(card, robot);
  setText(part(card, "presence"), presenceText(robot));
  for (const name of HOVERED[card.dataset.kind]) setIfOther(part(card, name), "title", utcText(robot));
  const rtt = robot.online && Number.isFinite(robot.rtt_ms) ? texts.rtt(Math.round(robot.rtt_ms)) : "";
  fillRow(card, "rtt", rtt);
  fillRow(card, "battery", batteryText(robot));
  const driver = driverText(robot);
  fillRow(card, "drivers", card.dataset.kind === "card" && driver ? texts.drives(driver) : driver);
  fillRow(card, "observers", robot.observers ? texts.watching(robot.observers) : "");
  fillRow(card, "site", robot.site ?? "");
  fillRow(card, "health", healthText(robot));
  titleWhatIsCut(card);
}

function titleWhatIsCut(card) {
  for (const element of MAY_BE_CUT[card.dataset.kind].map((name) => part(card, name))) setIfOther(element, "title", element.textContent);
}

// Writes only what changed: what does not is 500 robots' worth of work for the browser.
function fillData(card, robot) {
  const { state, online, video = "" } = robot;
  const data = { state, video, online: String(online), driven: String(isDriven(robot)) };
  for (const [name, value] of Object.entries(data)) setIfOther(card.dataset, name, value);
}

function fillRow(card, name, text) {
  setText(part(card, name), text);
  const row = part(card, `${name}-row`);
  if (row) setIfOther(row, "hidden", text === "");
}
