// The page of routes: the list and how each route is, the diagram on which people draw them, and its topics.

import { api } from "../dom/calls.js";
import { freshPage, make, part, setText, withoutTokens } from "../dom/page.js";
import { askOnce } from "../dom/presses.js";
import { Poller, tickWhileSeen } from "../queue/poller.js";
import { showDataState } from "../queue/requestRows.js";
import { routes as texts } from "../texts/routes.js";
import { RouteDiagram, isApp, routeType } from "../topics/routeDiagram.js";

const REFRESH_AFTER_MS = 2000; // least interval between two looks at the list that nobody here changed
const LIST_FRESH_MS = 5000; // time after which the list is asked for whatever is live: rights bring and take what has ended
const MOST_AT_ONCE = 4; // robots that are asked for their topics

// What rosapi says of a robot's topics, by name; null: that is no such answer. Pure.
export function topicsIn({ topics, types } = /** @type {any} */ ({})) {
  if (!Array.isArray(topics) || !Array.isArray(types) || topics.length !== types.length) return null;
  const named = topics.map((topic, index) => ({ topic, type: types[index] }));
  const readable = named.filter(({ topic, type }) => [topic, type].every((text) => typeof text === "string" && !/\s/.test(text)));
  return readable.sort((one, other) => (one.topic < other.topic ? -1 : 1));
}

// What the diagram shows of it: how its line looks, and its rate. Pure.
export function lineLook(route) {
  if (!route) return { state: "unknown", rate: "" };
  return { state: route.why ? "waits" : route.state, rate: route.state === "runs" ? texts.rate(route.rate_hz) : "" };
}

// What the list says of a route that lasts; `route` as GET /api/v1/routes/live has it, or undefined. Pure.
export function stateWords(route) {
  if (!route) return texts.unknown;
  if (route.state === "runs") return texts.runs(route.rate_hz ?? "?", route.why);
  return route.state === "waits" ? texts.waits(route.why) : texts.elsewhere;
}

// What the diagram shows of web apps, by their names in routes: the user's that are connected, and those that only the user's
// routes name, of which it knows no topics. Pure.
export function appsIn(live, rows) {
  const names = rows.flatMap(({ source, target }) => [source, target]).filter(isApp);
  // A relay of an earlier version says nothing of apps. Of two with one name, this machine's comes last and stays.
  const ofMachine = [...(live ?? [])].sort((one, other) => Number(!one.machine) - Number(!other.machine));
  const topics = ofMachine.map(({ name, machine, advertises, subscribes }) => [
    `app:${name}`,
    { source: advertises, target: subscribes, machine },
  ]);
  return new Map([...names.map((name) => [name, null]), ...topics]);
}

// Whether a route has a line: another user's app of the same name is another app. Pure.
export const isDrawn = (row) => "mine" in row || ![row.source, row.target].some(isApp);

// As the form sends it; an app has no MAC. Pure.
const valueOf = (robot, mac, { topic, type }) => [robot, topic, type, ...(mac ? [mac] : [])].join(" ");

const robotsOf = (root) => [...root.querySelectorAll("details[data-mac]")].map(({ dataset }) => `${dataset.mac} ${dataset.robot}`);

// Whether each robot of a page is in a newer one under the same name. Pure.
function hasAllOf(page, fresh) {
  const robots = new Set(robotsOf(fresh));
  return robotsOf(page).every((robot) => robots.has(robot));
}

// Asks robots for their topics, for the diagram and the form; those of apps come with the routes.
class Topics {
  constructor(diagram, form) {
    this.diagram = diagram;
    this.form = form;
    this.known = new Map(); // by robot or app, its topics by column
    this.shownApps = new Map(); // by app, its topics as a text
  }

  start() {
    const folded = [...this.diagram.area.querySelectorAll('[data-side="source"] details')];
    for (const details of folded) this.loadWhenOpen(details.dataset.robot);
    const robots = folded.filter(({ dataset }) => "online" in dataset).map(({ dataset }) => dataset.robot);
    const next = async () => {
      for (let robot = robots.shift(); robot; robot = robots.shift()) await this.load(robot);
    };
    for (let count = 0; count < MOST_AT_ONCE; count += 1) next();
  }

  // In either column; a robot is asked once.
  loadWhenOpen(robot) {
    for (const details of this.diagram.detailsOf(robot)) {
      details.addEventListener("toggle", () => details.open && !this.known.has(robot) && this.load(robot));
    }
  }

  async load(robot) {
    this.known.set(robot, { source: [], target: [] });
    this.diagram.show(robot, null, texts.loading);
    const { mac } = this.diagram.detailsOf(robot)[0].dataset;
    const { ok, detail, body } = await api.service(robot, "rosapi/topics", {}, { timeout_s: 5, mac });
    const list = ok && body.result ? topicsIn(body.values) : null;
    const topics = list && { source: list, target: list, mac };
    if (topics) this.known.set(robot, topics);
    else this.known.delete(robot);
    this.diagram.show(robot, topics, topics ? texts.noTopics : texts.unknownTopics(detail || body.reason));
    this.fillForm();
  }

  showApps(apps) {
    const absentApps = [...this.shownApps.keys()].filter((name) => !apps.has(name)).map((name) => [name, undefined]);
    const changes = [...absentApps, ...apps].filter(
      ([name, topics]) => JSON.stringify(topics) !== this.shownApps.get(name) && !this.diagram.isHeld(name),
    );
    for (const [name, topics] of changes) this.showApp(name, topics);
    if (changes.length) this.fillForm();
  }

  // `topics` is undefined for one that is gone, and null for one that is not connected.
  showApp(name, topics) {
    if (topics) this.known.set(name, topics);
    else this.known.delete(name);
    if (topics === undefined) {
      this.shownApps.delete(name);
      this.diagram.removeApp(name);
      return;
    }
    this.shownApps.set(name, JSON.stringify(topics));
    this.diagram.ensureApp(name, texts.app(name, topics?.machine));
    this.diagram.show(name, topics, topics ? texts.noTopicsHere : texts.appAway);
  }

  fillForm() {
    for (const select of this.form.querySelectorAll("select")) {
      const chosen = select.value;
      const side = select.name === "from" ? "source" : "target";
      const groups = [...this.known].sort().map(([robot, topics]) => {
        const options = topics[side].map((topic) =>
          make("option", { value: valueOf(robot, topics.mac, topic) }, `${robot} ${topic.topic}`),
        );
        return make("optgroup", { label: robot }, ...options);
      });
      select.replaceChildren(select.options[0], ...groups);
      select.value = chosen;
    }
  }
}

// The page with its list, which works without the diagram, too.
class RoutesPage {
  constructor(root) {
    this.list = part(root, "list");
    this.problem = part(root, "problem");
    this.rows = /** @type {HTMLElement[]} */ ([]);
    this.live = new Map();
    this.refreshedAt = performance.now();
    this.answered = ""; // the list as the server had it last
    this.diagram = /** @type {RouteDiagram | null} */ (null);
    this.topics = /** @type {Topics | null} */ (null);
    this.poller = new Poller({
      ask: () => api.get("/api/v1/routes/live"),
      onAnswer: (body) => this.receive(body),
      onState: (state) => {
        if (state.name !== "live") this.showLive([]);
        showDataState(root, part(root, "feed"), state);
      },
    });
  }

  start(panel, form) {
    if (panel) {
      panel.hidden = false;
      this.diagram = new RouteDiagram(panel, {
        connect: (from, to) => this.connect(from, to),
        remove: (row) => this.remove(row.dataset.route),
      });
      this.diagram.watch();
      this.topics = new Topics(this.diagram, form);
      this.topics.start();
    }
    this.showStates();
    this.list.addEventListener("submit", (event) => this.removeBy(event));
    tickWhileSeen(() => this.poller.tick());
  }

  async connect(from, to) {
    const type = routeType(from, to);
    if (type === null) return this.say(texts.notMade(texts.otherType(from, to)));
    const { ok, detail } = await api.post("/api/v1/routes", {
      source: from.robot,
      source_mac: from.mac,
      source_topic: from.topic,
      target: to.robot,
      target_mac: to.mac,
      target_topic: to.topic,
      type,
    });
    return this.settle(ok, texts.made, texts.notMade(detail));
  }

  removeBy(event) {
    event.preventDefault();
    this.remove(event.target.closest("[data-route]").dataset.route);
  }

  async remove(id) {
    const answer = await askOnce(id, () => api.ask(`/api/v1/routes/${id}`, { method: "DELETE" }));
    if (answer) await this.settle(answer.ok, texts.removed, texts.notRemoved(answer.detail));
  }

  async settle(ok, done, problem) {
    this.say(ok ? "" : problem);
    if (!ok) return;
    await this.refresh();
    this.diagram?.say(done);
  }

  say(problem) {
    this.problem.hidden = !problem;
    setText(this.problem, problem);
  }

  // Puts the list in place as the server has it now; without an answer what stands there stays.
  async refresh() {
    this.refreshedAt = performance.now();
    const page = await freshPage("/routes");
    const fresh = page && part(page, "list");
    if (fresh && !hasAllOf(document, page)) return location.reload();
    if (fresh && withoutTokens(fresh) !== this.answered) this.show(fresh);
  }

  show(fresh) {
    this.answered = withoutTokens(fresh);
    const focused = this.list.contains(document.activeElement) && document.activeElement?.closest("[data-route]");
    this.list.replaceChildren(...fresh.childNodes);
    if (focused) this.focusRow(focused.dataset.route);
    this.showStates();
  }

  // The button of another route must not come under a key that is being pressed.
  focusRow(id) {
    const button = this.list.querySelector(`[data-route="${id}"] button`);
    (button ?? part(this.list, "title")).focus({ preventScroll: true });
  }

  receive({ routes, apps }) {
    this.showLive(routes);
    const drawn = this.drawnRows().map(({ dataset }) => dataset);
    this.topics?.showApps(appsIn(apps, drawn));
    const refreshAfterMs = this.isOld() ? REFRESH_AFTER_MS : LIST_FRESH_MS;
    if (performance.now() - this.refreshedAt > refreshAfterMs) this.refresh();
  }

  showLive(routes) {
    this.live = new Map(routes.map((route) => [String(route.id), route]));
    this.showStates();
  }

  // Whether a route came or went; the relay knows that before the list does.
  isOld() {
    return this.live.size !== this.rows.length || this.rows.some(({ dataset }) => !this.live.has(dataset.route));
  }

  showStates() {
    this.rows = [...this.list.querySelectorAll("[data-route][data-lasts]")];
    for (const row of this.rows) {
      const route = this.live.get(row.dataset.route);
      setText(part(row, "state"), stateWords(route));
      Object.assign(row.dataset, lineLook(route));
    }
    this.diagram?.use(this.drawnRows());
  }

  drawnRows() {
    return this.rows.filter(({ dataset }) => isDrawn(dataset));
  }
}

if (typeof document !== "undefined") {
  const main = document.querySelector("main");
  new RoutesPage(main).start(part(main, "diagram-panel"), part(main, "form"));
}
