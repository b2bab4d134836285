// The wall: pictures of up to 20 robots under one person's eyes, those that ask for help first. Loaded by wall.html.

import { Feed } from "../client/feed.js";
import { api, LoginUse } from "../dom/calls.js";
import { byTestId, Choices, localTimestamp, matches, noteScript, part, reloadOnReturn, setText, TYPING } from "../dom/page.js";
import { Presses, isNew, markNew } from "../dom/presses.js";
import { offerDrive } from "../fleet/cards.js";
import { filterOf, fromQuery, inNameOrder, toQuery } from "../fleet/filters.js";
import { RobotList, throttled } from "../fleet/list.js";
import { Thumbs } from "../fleet/thumbs.js";
import { fillTile, heirs, keyOfPress, keysFor, MovingHand, namesOf, newTile, requestsByRobot, wallNames } from "../fleet/wall.js";
import { Poller, tickWhileSeen } from "../queue/poller.js";
import { feed as feedTexts } from "../texts/common.js";
import { data as dataTexts, wall as texts } from "../texts/queue.js";

const SHOW_EVERY_MS = 500;
const REQUESTS_EVERY_MS = 2000;

const main = /** @type {HTMLElement} */ (document.querySelector("main"));
const facts = JSON.parse(main.dataset.robots ?? "{}"); // level and camera, which the events do not have, and of which robot
const most = Number(main.dataset.most); // number of robots that one person watches, by the site's settings
const choices = new Choices("wall");
const [feedState, requestState] = [byTestId(main, "wall-feed"), byTestId(main, "wall-requests")];
const [search, keysBox] = [part(main, "search"), byTestId(main, "wall-keys")];
const thumbs = new Thumbs();
const robots = new Map();
const filter = fromQuery(location.search);
let byRobot = new Map();
/** @type {Map<string, string>} */
let keys = new Map();

const list = new RobotList({
  container: part(main, "wall"),
  template: document.getElementById("wall-tile"),
  make: newTile,
  fill: (tile, robot) =>
    fillTile(tile, robot, { request: byRobot.get(robot.mac), key: keys.get(robot.name), mayDrive: mayDrive(robot.name) }),
  onNew: (tile, name) => {
    tile.dataset.camera = facts[name]?.camera ?? "";
    const { mac } = robots.get(name);
    thumbs.add(tile, name, mac);
    if (mayDrive(name)) offerDrive(tile, mac);
  },
});
const showSoon = throttled(show, SHOW_EVERY_MS);
const hand = new MovingHand({ onRest: showSoon });

// A robot that came while the page was open: the drive page finds out.
function mayDrive(name) {
  return facts[name]?.level !== "observe";
}

// `searched`: because a person did so, who looks at what comes.
function show(searched = false) {
  if (poller.state === "connecting") return; // who asks for help is not known yet
  const fits = filterOf(filter);
  const all = inNameOrder(robots.keys())
    .map((name) => robots.get(name))
    .filter(({ state }) => state === "active");
  const fitting = all.filter(fits);
  const names = namesToShow(fitting);
  const before = { names: presentNames(), keys };
  keys = keysFor(names, keys);
  const shown = new Set(names);
  for (const name of list.elements.keys()) if (!shown.has(name)) list.remove(name, false);
  for (const name of names) list.fill(robots.get(name), true);
  list.arrange(names, shown);
  markHeirs(searched ? { places: [], keys: [] } : heirs(names, keys, before));
  setText(byTestId(main, "wall-asking"), texts.asking(namesOf(byRobot, robots.values())));
  count(names.length, fitting.length, all.length);
}

// Before the feed has come, nobody knows that there are none.
function count(shown, fitting, all) {
  const isLive = feedState.dataset.feed === "live";
  setText(byTestId(main, "wall-count"), robots.size > 0 || isLive ? texts.count(shown, fitting, all, most) : "");
  byTestId(main, "wall-empty").hidden = shown > 0 || !isLive;
}

const presentNames = () => [...list.container.children].map(({ dataset }) => dataset.robot);

// A hand that rests does not see a tile come under it; a key is for the robot that has it.
function markHeirs({ places, keys: withKeys }) {
  for (const name of places) markNew(part(list.elements.get(name), "drive"));
  for (const name of withKeys) markNew(part(list.elements.get(name), "key"));
}

// While a hand moves over the wall, each robot keeps its place.
function namesToShow(fitting) {
  const names = wallNames(fitting, byRobot, most);
  if (!hand.moves) return names;
  const present = presentNames();
  return present.length ? present.filter((name) => fitting.some((robot) => robot.name === name)) : names;
}

function receiveFleet(all) {
  robots.clear();
  all.forEach(receive);
  showSoon();
}

// Another robot may have got the name of one that is shown.
function receive(robot) {
  const { name, mac } = robot;
  if ((facts[name]?.mac ?? mac) !== mac) forget(name);
  (facts[name] ??= {}).mac = mac;
  robots.set(name, robot);
  showSoon();
}

function forget(name) {
  for (const known of [robots, keys]) known.delete(name);
  delete facts[name];
  list.remove(name, false);
  showSoon();
}

const feed = new Feed({
  onFleet: receiveFleet,
  onRobot: receive,
  onRemoved: ({ name }) => forget(name),
  onState: (state) => {
    feedState.dataset.feed = state;
    main.dataset.feed = state;
    setText(feedState, feedTexts[state]);
  },
});

const poller = new Poller({
  ask: () => api.get("/api/v1/requests", { state: "open" }),
  onAnswer: ({ requests }) => {
    byRobot = requestsByRobot(requests);
    showSoon();
  },
  onState: (state) => {
    const { name, since } = state;
    main.dataset.stale = String(name !== "live");
    setText(requestState, name === "live" ? "" : dataTexts[name]({ ...state, since: since && localTimestamp(since) }));
    showSoon();
  },
  everyMs: REQUESTS_EVERY_MS,
});

// One key takes a robot; a person who types, or has switched that off, takes none.
function takeByKey(event) {
  if (!keysBox.checked || matches(event.target, TYPING)) return;
  const key = keyOfPress(event);
  const name = key && [...keys].find(([, itsKey]) => itsKey === key)?.[0];
  const tile = name && list.elements.get(name);
  if (tile && !isNew(part(tile, "key"))) part(tile, "drive").click();
}

function setKeys(on) {
  choices.keep({ keys: on });
  main.dataset.keys = String(on);
}

search.value = filter.words;
search.addEventListener("input", () => {
  filter.words = search.value;
  history.replaceState(null, "", location.pathname + toQuery(filter));
  show(true);
});
keysBox.checked = choices.all.keys !== false;
setKeys(keysBox.checked);
keysBox.addEventListener("change", () => setKeys(keysBox.checked));
window.addEventListener("keydown", takeByKey);
reloadOnReturn();
hand.listen(part(main, "wall"));
new Presses().watch(window);
new LoginUse().watch(window);
feed.start();
noteScript();
tickWhileSeen(() => poller.tick());
