// The fleet page: keeps the robots as the feed reports them, as cards or as a table. Loaded by fleet.html.
// What changes is gathered for a frame and touches only what shows it; nothing moves under a pointer.

import { Feed } from "../client/feed.js";
import { offerDrive, robotOf } from "../fleet/cards.js";
import { filterOf, inNameOrder, inOrder, inWindow, WINDOW } from "../fleet/filters.js";
import { CardStop, FleetStops } from "../fleet/fleetStops.js";
import { Batch, PointerPause, RobotList, throttled } from "../fleet/list.js";
import { showNearest } from "../fleet/nearest.js";
import { Thumbs } from "../fleet/thumbs.js";
import { Toolbar } from "../fleet/toolbar.js";
import { feed as feedTexts } from "../texts/common.js";
import { fleet as texts } from "../texts/fleet.js";
import { LoginUse } from "../dom/calls.js";
import { byTestId, noteScript, part, reloadOnReturn, setText } from "../dom/page.js";
import { Presses } from "../dom/presses.js";

const ARRANGE_EVERY_MS = 1000;

const main = /** @type {HTMLElement} */ (document.querySelector("main"));
const feedState = byTestId(document, "fleet-feed");
const fleetStops = new FleetStops(main, { manages: main.dataset.manages === "yes" });
const stops = new Map();
const thumbs = new Thumbs();

const containers = { cards: part(main, "cards"), table: part(main, "rows") };
const robots = new Map([...containers.cards.children].map(({ dataset }) => [dataset.robot, robotOf(dataset)]));
// What the server wrote into the page and the events do not have; "" for a robot that came since.
const datasets = new Map([...containers.cards.children].map(({ dataset }) => [dataset.robot, { ...dataset }]));
const lists = { cards: listIn(containers.cards, "robot-card"), table: listIn(containers.table, "robot-row") };

const toolbar = new Toolbar(main, { onFilter: arrangeNow, onView: showView });
const batch = new Batch(update);
const arrangeSoon = throttled(arrangeUnlessPaused, ARRANGE_EVERY_MS);
const pause = new PointerPause({ onEnd: () => arrangeLater && arrangeSoon() });
/** @type {string[] | null} */
let inOrderOfNames = inNameOrder(robots.keys());
let arrangeLater = false;
/** @type {{ shown: Set<string>, left: number }} */
let listWindow = { shown: new Set(robots.keys()), left: 0 };
let windowLength = WINDOW;
const more = part(main, "more");
more.addEventListener("click", () => {
  windowLength += WINDOW;
  arrangeNow();
});
for (const listed of [...Object.values(containers), part(main, "stops")]) pause.listen(listed);
showView();

function listIn(container, template) {
  return new RobotList({ container, template: document.getElementById(template), onNew: prepare });
}

function prepare(element, name) {
  const { camera = "", level = "" } = datasets.get(name) ?? {};
  element.dataset.camera ||= camera;
  element.dataset.level ||= level;
  stopOf(name).join(element);
  const mac = robots.get(name)?.mac;
  thumbs.add(element, name, mac);
  offerDrive(element, mac);
}

function stopOf(name) {
  if (!stops.has(name)) {
    stops.set(name, new CardStop(name));
    stops.get(name).receive(robots.get(name));
  }
  return stops.get(name);
}

function shownList() {
  return lists[toolbar.view];
}

// A list that is not shown is not kept up to date either; it is filled when it is.
function showView() {
  for (const [view, container] of Object.entries(containers)) {
    container.closest("[data-list]").hidden = view !== toolbar.view;
  }
  for (const robot of robots.values()) shownList().fill(robot, false);
  arrangeNow();
}

function showFleet(all) {
  const names = new Set(all.map(({ name }) => name));
  for (const name of robots.keys()) if (!names.has(name)) remove(name);
  for (const robot of all) receive(robot);
}

function receive(robot) {
  const { mac } = robots.get(robot.name) ?? robot;
  if (mac !== robot.mac) remove(robot.name); // another robot got the name
  if (!robots.has(robot.name)) inOrderOfNames = null;
  robots.set(robot.name, robot);
  batch.add(robot.name);
}

function update(names) {
  const fits = filterOf(toolbar.filter);
  for (const name of names) {
    const robot = robots.get(name);
    if (!robot) continue;
    shownList().fill(robot, fits(robot) && (listWindow.left === 0 || listWindow.shown.has(name)));
    stopOf(name).receive(robot);
  }
  if (fleetStops.results.length) fleetStops.receive([...robots.values()]);
  arrangeSoon();
}

function remove(name) {
  for (const known of [robots, stops, datasets]) known.delete(name);
  inOrderOfNames = null;
  for (const list of Object.values(lists)) list.remove(name, pause.active);
  arrangeSoon();
}

// What a person chose is done at once.
function arrangeNow() {
  batch.flush();
  arrange();
}

function arrangeUnlessPaused() {
  batch.flush();
  if (pause.active) arrangeLater = true;
  else arrange();
}

function arrange() {
  arrangeLater = false;
  inOrderOfNames ??= inNameOrder(robots.keys());
  const listed = inOrderOfNames.map((name) => /** @type {any} */ (robots.get(name)));
  const fits = filterOf(toolbar.filter);
  const fitting = new Set(listed.filter(fits).map(({ name }) => name));
  const order = inOrder(listed, toolbar.filter).map(({ name }) => name);
  listWindow = inWindow(order, (name) => fitting.has(name), windowLength);
  shownList().arrange(order, listWindow.shown);
  more.hidden = listWindow.left === 0;
  setText(more, texts.more(Math.min(WINDOW, listWindow.left), listWindow.left));
  toolbar.offerSites(listed);
  toolbar.count({ online: listed.filter(({ online }) => online).length, all: listed.length, shown: fitting.size });
  part(main, "empty").hidden = listed.length > 0;
  const add = part(main, "add"); // an admin's; an empty fleet has it in its notice
  if (add) add.hidden = listed.length === 0;
  fleetStops.show(listed.map((robot) => ({ ...robot, level: datasets.get(robot.name)?.level ?? "" })));
}

const feed = new Feed({
  onFleet: showFleet,
  onRobot: receive,
  onRemoved: ({ name }) => remove(name),
  onState: (state) => {
    feedState.dataset.feed = state;
    main.dataset.feed = state;
    setText(feedState, feedTexts[state]);
  },
});

feed.start();
noteScript();
const nearest = part(main, "nearest"); // only where the site has other machines
if (nearest) showNearest(nearest);
new Presses().watch(window);
reloadOnReturn();
new LoginUse().watch(window);
