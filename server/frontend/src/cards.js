// Shows robots as cards. The markup is the server's (_robot_card.html); here it is only filled in.

import { part, setText, localTime } from "./page.js";
import { fleet as texts } from "./texts.js";

const collator = new Intl.Collator("en", { numeric: true });

// Online robots first, then by name as a person counts: sim2 before sim10.
export function inOrder(robots) {
  return [...robots].sort(
    (a, b) => Number(b.online) - Number(a.online) || collator.compare(a.name, b.name),
  );
}

export function presenceText({ state, online, since }) {
  if (state === "pending") return texts.pending;
  if (state === "disabled") return texts.disabled;
  return online ? texts.online(localTime(since)) : texts.offline(localTime(since));
}

export function healthText({ online, ros, video }) {
  if (!online) return "";
  const down = [ros === "down" && texts.ros, video === "down" && texts.video];
  return down.filter(Boolean).join(", ");
}

// Who drives, or is about to, and who asks for it.
export function driverText({ control }) {
  const { driver, reserved, waiting } = control ?? {};
  const name = (driver ?? reserved)?.user ?? "";
  return waiting && name ? texts.driverAsked(name, waiting.user) : name;
}

// Makes a card out of the page's template for a robot that the server did not render.
export function newCard(template, { name }) {
  const card = template.content.firstElementChild.cloneNode(true);
  card.dataset.robot = name;
  card.dataset.testid = `robot-card-${name}`;
  const link = part(card, "name");
  link.href = `/robots/${encodeURIComponent(name)}`;
  link.textContent = name;
  return card;
}

export function fillCard(card, robot) {
  card.dataset.online = String(robot.online);
  card.dataset.state = robot.state;
  setText(part(card, "presence"), presenceText(robot));
  const rtt = robot.online && Number.isFinite(robot.rtt_ms) ? texts.rtt(Math.round(robot.rtt_ms)) : "";
  fillRow(card, "rtt", rtt);
  fillRow(card, "drivers", driverText(robot));
  fillRow(card, "observers", robot.observers ? String(robot.observers) : "");
  fillRow(card, "health", healthText(robot));
}

function fillRow(card, name, text) {
  setText(part(card, name), text);
  part(card, `${name}-row`).hidden = text === "";
}
