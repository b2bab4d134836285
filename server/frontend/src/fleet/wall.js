// The wall of robots' pictures: which robots it shows, in which order, and by which key each is taken. Pure except for the markup,
// which is the server's (wall.html).

import { cloned } from "../dom/keyedRows.js";
import { part, setText } from "../dom/page.js";
import { ageText, reasonText } from "../queue/requestRows.js";
import { fleet as fleetTexts } from "../texts/fleet.js";
import { requests as requestTexts, wall as texts } from "../texts/queue.js";
import { driverText, healthText, presenceText } from "./cards.js";

const KEYS = [..."1234567890qwertyuiop"]; // two rows of the keyboard, and so the maximum number of robots on the wall

// The open request of each robot that is first in line, by MAC, as the events may know of a new name earlier or later; `requests`
// come the most urgent first, then the oldest.
export function requestsByRobot(requests) {
  const byRobot = new Map();
  for (const request of requests) if (!byRobot.has(request.mac)) byRobot.set(request.mac, request);
  return byRobot;
}

// The names on the wall, `most` of them: robots that ask for help as their requests come, then those online; `robots` come in the
// order of names.
export function wallNames(robots, byRobot, most = KEYS.length) {
  const others = robots.filter(({ mac }) => !byRobot.has(mac));
  const online = others.filter((robot) => robot.online);
  const offline = others.filter((robot) => !robot.online);
  return [...namesOf(byRobot, robots), ...[...online, ...offline].map(({ name }) => name)].slice(0, most);
}

// The names of the robots that ask for help, as their requests come.
export function namesOf(byRobot, robots) {
  const names = new Map([...robots].map(({ mac, name }) => [mac, name]));
  return [...byRobot.keys()].flatMap((mac) => names.get(mac) ?? []);
}

// A robot keeps its key while it is on the wall, wherever it moves: a press must meet the robot that it was meant for.
export function keysFor(names, before = new Map()) {
  const keys = new Map(names.filter((name) => before.has(name)).map((name) => [name, before.get(name)]));
  const taken = new Set(keys.values());
  const free = KEYS.filter((key) => !taken.has(key));
  for (const name of names) if (!keys.has(name)) keys.set(name, free.shift());
  return keys;
}

// Those of `names`, in their order on the wall, whose place or key was another robot's `before` {names, keys}: a press may have been
// meant for that one.
export function heirs(names, keys, before) {
  const owners = new Map([...before.keys].map(([name, key]) => [key, name]));
  const isOther = (name, former) => former !== undefined && former !== name;
  return {
    places: names.filter((name, i) => isOther(name, before.names[i])),
    keys: names.filter((name) => isOther(name, owners.get(keys.get(name)))),
  };
}

// The key of the wall that a press means, or "". On any layout, the digits are those of the top row or the number pad.
export function keyOfPress({ key, code, ctrlKey, metaKey, altKey, repeat }) {
  if (ctrlKey || metaKey || altKey || repeat) return "";
  const [, digit] = /^(?:Digit|Numpad)(\d)$/.exec(code) ?? [];
  const pressed = digit ?? key.toLowerCase();
  return KEYS.includes(pressed) ? pressed : "";
}

// What a robot asks for, in words; empty when it asks for nothing.
function askingText(request) {
  if (!request) return "";
  const { age_s: age, priority, state, accepted_by: name } = request;
  const words = texts.asks(reasonText(request), ageText(age));
  const marked = priority === 1 ? texts.urgent(words) : words;
  return state === "accepted" ? texts.accepted(marked, name ?? requestTexts.unknown) : marked;
}

// Makes the tile of a robot.
export function newTile(template, { name }) {
  const tile = cloned(template);
  tile.dataset.robot = name;
  tile.dataset.testid = `wall-${name}`;
  part(tile, "drive").href = `/robots/${encodeURIComponent(name)}`;
  setText(part(tile, "name"), name);
  return tile;
}

// `robot` as of the fleet's events, `request` its open one, `key` that which takes it.
export function fillTile(tile, robot, { request, key, mayDrive }) {
  Object.assign(tile.dataset, { online: String(robot.online), video: robot.video ?? "", asks: String(Boolean(request)) });
  setText(part(tile, "presence"), presenceText(robot));
  const driver = driverText(robot);
  setText(part(tile, "driver"), driver && fleetTexts.drives(driver));
  setText(part(tile, "health"), troubleText(robot));
  const asks = part(tile, "asks");
  setText(asks, askingText(request));
  asks.title = asks.textContent; // a long one is cut
  setText(part(tile, "key"), key.toUpperCase());
  setText(part(tile, "act"), mayDrive ? texts.drive : texts.watch);
  part(tile, "drive").setAttribute("aria-keyshortcuts", key.toUpperCase());
}

function troubleText(robot) {
  const { stopped } = robot.control ?? {};
  if (stopped) return texts.stopped(stopped.by);
  return healthText(robot);
}

// Whether a person's hand moves over the wall: then no tile moves. A hand that rests there must not hold it up for hours.
const RESTING_MS = 3000; // time after which a pointer rests

export class MovingHand {
  constructor({ onRest, now = () => performance.now() }) {
    this.onRest = onRest;
    this.now = now;
    this.movedAt = -Infinity;
  }

  listen(wall) {
    for (const name of ["pointermove", "pointerdown", "wheel"]) wall.addEventListener(name, () => this.move(), { passive: true });
  }

  move() {
    this.movedAt = this.now();
    clearTimeout(this.timer);
    this.timer = setTimeout(this.onRest, RESTING_MS);
  }

  get moves() {
    return this.now() - this.movedAt < RESTING_MS;
  }
}
