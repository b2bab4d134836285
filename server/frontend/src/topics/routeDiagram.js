// Robots and web apps in two columns with their topics, and lines between them: the routes, which people draw and remove.

import { plainType } from "../client/rosbridge.js";
import { KeyedRows } from "../dom/keyedRows.js";
import { make, makeButton, part, setText } from "../dom/page.js";
import { routes as texts } from "../texts/routes.js";

const DRAG_PX = 8;
const RATE_BELOW_PX = 36;
const SVG = "http://www.w3.org/2000/svg";

// A line from the right edge of one thing to the left edge of another. Pure.
/** @param {number[]} from @param {number[]} to */
function linePath([fromX, fromY], [toX, toY]) {
  const bend = Math.max(24, Math.abs(toX - fromX) / 2);
  return `M${fromX} ${fromY} C${fromX + bend} ${fromY} ${toX - bend} ${toY} ${toX} ${toY}`;
}

// Whether an end of a route is a web app, by its name. Pure.
export const isApp = (name) => name.startsWith("app:");

// The type of a route: the robot's; an app may spell it as either ROS does. null: the ends differ. Pure.
export function routeType(from, to) {
  if (from.type === to.type) return from.type;
  if (isApp(from.robot) === isApp(to.robot) || plainType(from.type) !== plainType(to.type)) return null;
  return isApp(from.robot) ? to.type : from.type;
}

function endOf(button) {
  const { of: robot, topic, type } = button.dataset;
  return { robot, mac: button.closest("details").dataset.mac, topic, type };
}

// The two columns. `connect` gets the two ends of a route that somebody has drawn, `remove` the row of one.
export class RouteDiagram {
  constructor(root, { connect, remove }) {
    this.root = root;
    this.area = part(root, "diagram");
    this.lines = part(root, "lines");
    this.knots = new KeyedRows({
      container: part(root, "knots"),
      keyOf: ({ row }) => row.dataset.route,
      make: ({ row }) => this.knot(row),
      fill: (button, { from, to }) => place(button, from, to),
    });
    this.connect = connect;
    this.remove = remove;
    this.armed = /** @type {HTMLElement | null} */ (null);
    this.drag = /** @type {{button: HTMLElement, pointer: number, x: number, y: number, path: Element | null} | null} */ (null);
    this.rows = [];
  }

  watch() {
    this.area.addEventListener("click", (event) => this.press(event.target.closest("button.topic")));
    this.area.addEventListener("keydown", (event) => event.key === "Escape" && this.arm(null));
    this.area.addEventListener("pointerdown", (event) => this.begin(event));
    window.addEventListener("pointermove", (event) => this.move(event));
    window.addEventListener("pointerup", (event) => this.drop(event));
    window.addEventListener("pointercancel", () => this.endDrag());
    for (const details of this.area.querySelectorAll("details")) details.addEventListener("toggle", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(this.area);
    this.arm(null);
  }

  press(button) {
    if (this.dragged || this.drag?.path || !button) return;
    if (isSource(button)) this.arm(button === this.armed ? null : button);
    else if (this.armed) this.join(this.armed, button);
  }

  join(source, target) {
    this.arm(null);
    this.connect(endOf(source), endOf(target));
  }

  // What the next press on the right begins at.
  arm(button) {
    this.armed = button;
    for (const each of this.area.querySelectorAll("button.topic")) {
      if (isSource(each)) each.setAttribute("aria-pressed", String(each === button));
      else each.classList.toggle("other", Boolean(button) && !isFit(button, each));
    }
    this.say(button ? texts.chosen(endOf(button)) : texts.choose);
  }

  begin(event) {
    this.dragged = false;
    const button = event.target.closest("button.topic");
    if (!button || !isSource(button) || !event.isPrimary || event.button !== 0) return;
    this.drag = { button, pointer: event.pointerId, x: event.clientX, y: event.clientY, path: null };
  }

  // Another finger neither leads nor ends the line.
  move({ pointerId, clientX, clientY }) {
    const drag = this.drag;
    if (!drag || drag.pointer !== pointerId) return;
    if (!drag.path && Math.hypot(clientX - drag.x, clientY - drag.y) < DRAG_PX) return;
    const path = drag.path ?? this.beginLine(drag.button);
    drag.path = path;
    const { left, top } = this.area.getBoundingClientRect();
    path.setAttribute("d", linePath(this.edge(drag.button, "right"), [clientX - left, clientY - top]));
  }

  beginLine(button) {
    this.arm(button);
    const path = drawn("path", { class: "line drag" });
    this.lines.append(path);
    return path;
  }

  drop({ pointerId, clientX, clientY }) {
    const drag = this.drag;
    if (!drag || drag.pointer !== pointerId) return;
    if (!drag.path) {
      this.drag = null;
      return;
    }
    const target = /** @type {HTMLElement | null} */ (document.elementFromPoint(clientX, clientY)?.closest("button.topic") ?? null);
    this.dragged = true; // the click that a browser may still make of it means nothing
    setTimeout(() => (this.dragged = false));
    this.endDrag();
    if (target && !isSource(target)) this.join(drag.button, target);
    else this.arm(null);
  }

  endDrag() {
    this.drag?.path?.remove();
    this.drag = null;
  }

  // Shows the topics of a robot or an app in each column, or why there are none.
  /** @param {string} name @param {{source: object[], target: object[]} | null} topics @param {string} why */
  show(name, topics, why) {
    for (const details of this.detailsOf(name)) {
      const list = part(details, "topics");
      if (list.contains(document.activeElement)) continue; // never under somebody's keyboard
      const buttons = (topics?.[sideOf(details)] ?? []).map((topic) => make("li", {}, topicButton(name, topic)));
      list.replaceChildren(...(buttons.length ? buttons : [make("li", { class: "soft" }, why)]));
    }
    this.arm(this.armed?.isConnected ? this.armed : null);
    this.draw();
  }

  // Apps come and go while the page is open.
  ensureApp(name, title) {
    const shown = this.detailsOf(name);
    for (const details of shown) setText(details.querySelector("summary"), title);
    if (shown.length) return;
    for (const column of this.area.querySelectorAll(".column")) {
      const summary = make("summary", {}, title);
      const details = make("details", { "data-robot": name, open: "" }, summary, make("ul", { "data-part": "topics" }));
      details.addEventListener("toggle", () => this.draw());
      column.append(details);
    }
  }

  removeApp(name) {
    for (const details of this.detailsOf(name)) details.remove();
    this.arm(this.armed?.isConnected ? this.armed : null);
    this.draw();
  }

  // Whether somebody's keyboard or pointer is at it.
  isHeld(name) {
    return this.detailsOf(name).some((each) => each.contains(document.activeElement) || each.contains(this.drag?.button ?? null));
  }

  say(words) {
    setText(part(this.root, "hint"), words);
  }

  detailsOf(name) {
    return [...this.area.querySelectorAll("details")].filter(({ dataset }) => dataset.robot === name);
  }

  use(rows) {
    this.rows = rows;
    this.draw();
  }

  // A line for each route that lasts and whose ends are both here, with a button in its middle that removes it.
  draw() {
    const ends = this.rows.map((row) => ({ row, ...this.endsOf(row.dataset) })).filter(({ from, to }) => from && to);
    this.lines.replaceChildren(
      ...ends.map(({ row, from, to }) => drawn("path", { class: `line ${row.dataset.state}`, d: linePath(from, to) })),
      ...ends.map(({ row, from, to }) => rateText(row.dataset.rate, middle(from, to))),
      ...(this.drag?.path ? [this.drag.path] : []),
    );
    this.knots.show(ends);
  }

  knot(row) {
    const words = texts.remove(row.dataset);
    const attributes = { class: "knot", "data-route": row.dataset.route, "aria-label": words, title: words };
    return makeButton(`remove-${row.dataset.route}`, "×", () => this.remove(row), attributes);
  }

  endsOf({ source, sourceTopic, target, targetTopic }) {
    const from = this.endIn("source", source, sourceTopic);
    const to = this.endIn("target", target, targetTopic);
    return { from: from && this.edge(from, "right"), to: to && this.edge(to, "left") };
  }

  // The topic, or what has it where the topic is folded away or not known.
  endIn(side, robot, topic) {
    const [details] = this.detailsOf(robot).filter((each) => sideOf(each) === side);
    if (!details) return null;
    const buttons = details.open ? [...details.querySelectorAll("button.topic")] : [];
    return buttons.find(({ dataset }) => dataset.topic === topic) ?? details.querySelector("summary");
  }

  edge(element, side) {
    const { left, top } = this.area.getBoundingClientRect();
    const box = element.getBoundingClientRect();
    return [box[side] - left, box.top + box.height / 2 - top];
  }
}

const sideOf = (element) => element.closest(".column").dataset.side;
const isSource = (button) => sideOf(button) === "source";

function isFit(source, target) {
  const [from, to] = [endOf(source), endOf(target)];
  return routeType(from, to) !== null && to.robot !== from.robot && !(isApp(from.robot) && isApp(to.robot));
}

function topicButton(robot, { topic, type }) {
  const attributes = { type: "button", class: "topic", "data-of": robot, "data-topic": topic, "data-type": type, title: type };
  return make("button", attributes, topic, " ", make("span", { class: "type" }, type.split("/").at(-1)));
}

function drawn(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

const middle = (from, to) => [(from[0] + to[0]) / 2, (from[1] + to[1]) / 2];

function place(button, from, to) {
  const [x, y] = middle(from, to);
  button.style.left = `${x}px`;
  button.style.top = `${y}px`;
}

// Below the button that removes the route.
function rateText(words, at) {
  const [x, y] = at;
  const text = drawn("text", { class: "rate", x, y: y + RATE_BELOW_PX });
  text.textContent = words;
  return text;
}
