// The fleet page: keeps the cards as the feed tells. Loaded by fleet.html.

import { fillCard, inOrder, newCard } from "./cards.js";
import { CardStop } from "./cardstop.js";
import { Feed } from "./feed.js";
import { FleetStops } from "./fleetstops.js";
import { byTestId, part, setText } from "./page.js";
import { feed as feedTexts, fleet as texts } from "./texts.js";

const list = part(document, "cards");
const template = document.getElementById("robot-card");
const feedState = byTestId(document, "fleet-feed");
const main = document.querySelector("main");
const fleetStops = new FleetStops(main, { manages: main.dataset.manages === "yes" });
const robots = new Map();
const stops = new Map();
const cards = new Map([...list.children].map((card) => [card.dataset.robot, card]));

function showFleet(all) {
  const names = new Set(all.map(({ name }) => name));
  for (const name of [...cards.keys()]) if (!names.has(name)) remove(name);
  for (const robot of all) update(robot);
  arrange();
}

function update(robot) {
  if (!cards.has(robot.name)) cards.set(robot.name, newCard(template, robot));
  robots.set(robot.name, robot);
  fillCard(cards.get(robot.name), robot);
  stopOf(robot.name).hear(robot);
}

function stopOf(name) {
  if (!stops.has(name)) stops.set(name, new CardStop(cards.get(name), name));
  return stops.get(name);
}

function remove(name) {
  cards.get(name)?.remove();
  cards.delete(name);
  stops.delete(name);
  robots.delete(name);
}

for (const [name, card] of cards) stopOf(name).hear({ state: card.dataset.state });

// Moves only what is out of place: a card that moves loses the keyboard focus.
function arrange() {
  const focused = document.activeElement;
  inOrder(robots.values()).forEach(({ name }, place) => {
    const card = cards.get(name);
    if (list.children[place] !== card) list.insertBefore(card, list.children[place] ?? null);
  });
  if (focused !== document.activeElement) focused.focus();
  const online = [...robots.values()].filter((robot) => robot.online).length;
  setText(part(document, "count"), robots.size ? texts.count(online, robots.size) : "");
  part(document, "empty").hidden = robots.size > 0;
  const withLevels = [...robots.values()].map((robot) => ({
    ...robot,
    level: cards.get(robot.name).dataset.level,
  }));
  fleetStops.show(withLevels);
}

const feed = new Feed({
  onFleet: showFleet,
  onRobot: (robot) => {
    update(robot);
    arrange();
  },
  onRemoved: ({ name }) => {
    remove(name);
    arrange();
  },
  onState: (state) => {
    feedState.dataset.feed = state;
    setText(feedState, feedTexts[state]);
  },
});

feed.start();
