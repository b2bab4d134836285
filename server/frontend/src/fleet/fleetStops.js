// The fleet page's Stop buttons: that of one robot, those of all robots that this user manages or of a site, and what became of it.

import { AGAIN_MS, Stopping, TRIES, refusal } from "../control/stopping.js";
import { api, stopAll } from "../dom/calls.js";
import { localTime, make, makeButton, part, setIfOther, setText } from "../dom/page.js";
import { stop as stopTexts } from "../texts/common.js";
import { fleet as texts } from "../texts/fleet.js";

// The sites that a manager can stop as a whole, in order. `robots` are {site, level}; the level is "" for a robot
// that came while the page was open. Pure.
function managedSites(robots) {
  const managed = robots.filter(({ site, level }) => site && ["manage", ""].includes(level));
  return [...new Set(managed.map(({ site }) => site))].sort();
}

// Those of a site, of all without one, that this user sees and does not manage. Pure.
const unmanaged = (robots, site) => robots.filter((robot) => (!site || robot.site === site) && ["observe", "drive"].includes(robot.level));

// Whether the robot's guard has the stop: by the answer, or by what its control object has said since. Pure.
const isConfirmed = ({ confirmed }, control) => (control?.stopped ? control.stopped.confirmed : confirmed);

// What is said of each robot, by the answer and what the events say of that robot now, whose name may be another. Pure.
export function outcome(result, { name = result.name, control } = /** @type {any} */ ({})) {
  const stopped = Boolean(control?.stopped) || result.stopped;
  return texts.stopResult({ name, stopped, confirmed: isConfirmed(result, control) });
}

// Its stop is over: what was said of it is no longer so. Pure.
const isReleased = (before, now) => Boolean(before?.stopped && now && !now.stopped);

// That of each of these control objects, or undefined where they differ. Pure.
const commonGuard = (controls) => (new Set(controls.map((control) => control?.guard)).size === 1 ? controls[0]?.guard : undefined);

export class FleetStops {
  // `manages`: this user may stop more than one robot at once.
  constructor(root, { manages }) {
    this.manages = manages;
    this.bar = part(root, "stops");
    this.result = part(root, "stop-result");
    this.byMac = new Map(); // robots
    this.robots = []; // with their levels
    this.results = [];
    this.unreached = []; // machines of the site, when the results came
    this.shown = null;
    this.round = 0;
  }

  // `robots` are {name, mac, site, level, control}.
  show(robots) {
    this.receive(robots);
    this.robots = robots;
    this.bar.hidden = !this.manages || robots.length === 0;
    this.offer(managedSites(robots));
  }

  // What became of a stop, without a change of the buttons, which would move under a finger.
  receive(robots) {
    const { byMac, results } = this;
    this.byMac = new Map(robots.map((robot) => [robot.mac, robot]));
    this.results = results.filter(({ mac }) => !isReleased(byMac.get(mac)?.control, this.controlOf(mac)));
    if (results.length) this.list();
  }

  controlOf(mac) {
    return this.byMac.get(mac)?.control;
  }

  // New buttons only for other words: one that is replaced loses the keyboard focus.
  offer(sites) {
    const has = (site) => unmanaged(this.robots, site).length > 0;
    const words = [texts.stopAll(has()), ...sites.map((site) => texts.stopSite(site, has(site)))];
    const wanted = words.join("\n");
    if (wanted === this.shown) return;
    this.shown = wanted;
    const all = makeButton("stop-all", words[0], () => this.stop());
    const each = sites.map((site, place) => makeButton(`stop-site-${site}`, words[place + 1], () => this.stop(site)));
    this.bar.replaceChildren(all, ...each);
  }

  stop(site) {
    this.results = [];
    this.site = site;
    setText(this.result, texts.stoppingAll);
    return this.attempt(site, ++this.round, TRIES);
  }

  // Again until the server has it, as with one robot, and no longer than until the next press.
  async attempt(site, round, tries) {
    clearTimeout(this.timer);
    const answer = await stopAll(site);
    if (round === this.round) this.settle(answer, site, round, tries - 1);
  }

  settle({ ok, status, detail, body }, site, round, tries) {
    this.results = ok ? body.robots : [];
    this.unreached = ok ? body.cells_unreached : [];
    if (ok) return this.list();
    const why = refusal(status, tries);
    /** @type {(facts: {detail: string, guard: string}) => string} */
    const words = stopTexts[why];
    setText(this.result, words({ detail, guard: commonGuard([...this.byMac.values()].map(({ control }) => control)) }));
    if (why === "unheard") this.timer = setTimeout(() => this.attempt(site, round, tries), AGAIN_MS);
  }

  list() {
    const lines = this.results.map((result) => outcome(result, this.byMac.get(result.mac)));
    const others = unmanaged(this.robots, this.site).filter(({ mac }) => !this.controlOf(mac)?.stopped).length;
    if (lines.length && others) lines.push(texts.stopOthers(others));
    if (this.results.some((result) => !isConfirmed(result, this.controlOf(result.mac))))
      lines.push(...this.unreached.map(texts.stopUnreached));
    if (lines.join("\n") === this.lines && this.result.querySelector("ul")) return;
    this.lines = lines.join("\n");
    const items = lines.map((line) => make("li", {}, line));
    this.result.replaceChildren(...(items.length ? [make("ul", {}, ...items)] : []));
  }
}

// The Stop button of one robot on the fleet page, and what is known of that robot's stop. A robot has one, in the card or
// in the row of the table, whichever is shown.
export class CardStop {
  constructor(robot) {
    this.robot = robot;
    this.cards = new Set();
    this.state = "";
    this.stopping = new Stopping({
      send: () => {}, // this page has no connection to the robot
      post: (press) => api.stop(robot, press, this.mac),
      onChange: () => this.show(),
    });
  }

  join(card) {
    this.cards.add(card);
    const button = part(card, "stop");
    setText(part(button, "stop-name"), ` ${this.robot}`);
    button.addEventListener("click", () => this.stopping.press());
    this.show();
  }

  // `robot` as of the events. One that waits for approval, or is disabled, has no connection to stop.
  receive({ mac, state, control }) {
    this.mac = mac;
    this.state = state;
    this.guard = control?.guard;
    this.stopping.receive(control?.stopped);
  }

  show() {
    const { kind, by, at, detail } = this.stopping.shown;
    const words = stopTexts[kind]({ by, at: localTime(at), detail, guard: this.guard });
    for (const card of this.cards) {
      setIfOther(part(card, "stop"), "hidden", this.state !== "active");
      setIfOther(card.dataset, "stop", kind);
      setText(part(card, "stopped"), words);
      setIfOther(part(card, "stopped-row"), "hidden", kind === "none");
    }
  }
}
