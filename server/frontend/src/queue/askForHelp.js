// Asking for help on the drive page, in its drawer, and what is asked for now. It must never touch what drives.

import { robotPath } from "../client/api.js";
import { KeyedRows } from "../dom/keyedRows.js";
import { byTestId, make, makeButton, part, setText } from "../dom/page.js";
import { askOnce, markNew } from "../dom/presses.js";
import { help as texts } from "../texts/queue.js";
import { endOf, keyOfRequest, requestFacts } from "./requestRows.js";

const NORMAL = 2;
const URGENT = 1;
const BY_PEOPLE = ["api", "page"]; // sources of requests that name a user; a robot may have the same name

export class AskForHelp {
  // `root` is the body: the drawer has the form and the list, the header says that something is open. `post(path, body)` as of
  // client/api.js; `onAsked()` asks for the list anew.
  constructor(root, { robot, mac, me, level, post, onAsked }) {
    this.root = root;
    this.mac = mac;
    this.path = robotPath(robot, "requests", { mac });
    this.post = post;
    this.onAsked = onAsked;
    this.manages = level === "manage";
    this.me = me;
    this.open = [];
    this.panel = part(root, "help");
    this.form = part(root, "help-form"); // who only watches has none
    this.list = part(this.panel, "help-list");
    const make = (request) => this.make(request);
    const fill = (item, request) => this.fill(item, request);
    this.rows = new KeyedRows({ container: this.list, keyOf: keyOfRequest, make, fill });
    this.form?.addEventListener("submit", (event) => this.ask(event));
  }

  async ask(event) {
    event.preventDefault();
    const reason = part(this.form, "help-reason");
    const urgent = part(this.form, "help-urgent");
    const body = { reason: reason.value.trim(), priority: urgent.checked ? URGENT : NORMAL };
    const answer = await this.post(this.path, body);
    this.say(outcomeText(answer, body));
    if (!answer.ok) return;
    reason.value = "";
    urgent.checked = false;
    this.onAsked();
  }

  // `requests` are the open ones of what has the robot's name, or null where that is not known.
  receive(requests) {
    const open = (requests ?? []).filter(({ mac }) => mac === this.mac);
    this.open = open;
    setText(part(this.root, "help-badge"), open.length ? texts.open : "");
    part(this.root, "help-badge").hidden = open.length === 0;
    setText(part(this.panel, "help-state"), requests ? "" : texts.unknown);
    const hadFocus = this.list.contains(document.activeElement);
    this.rows.showInPlace(open);
    if (hadFocus && !this.list.contains(document.activeElement)) part(this.root, "drawer").focus({ preventScroll: true });
  }

  make({ id }) {
    const end = makeButton("help-withdraw", "", () => this.end(id));
    const words = [make("span", { "data-part": "reason" }), make("small", { "data-part": "facts" })];
    return make("li", {}, make("p", {}, ...words), end);
  }

  fill(item, request) {
    const { reason, priority, state, age } = requestFacts(request);
    setText(part(item, "reason"), reason);
    setText(part(item, "facts"), [priority, state, age].join(" · "));
    showEnd(byTestId(item, "help-withdraw"), this.endOf(request));
  }

  // How this person may end it: as the one who works on it, as a manager, or as the one who asked. Empty: not at all.
  endOf(request) {
    const { source, asked_by: asker, accepted_by: operator } = request;
    if (this.manages || operator === this.me) return endOf(request);
    return asker === this.me && BY_PEOPLE.includes(source) ? "cancel" : "";
  }

  async end(id) {
    const action = this.endOf(this.open.find((request) => request.id === id));
    const answer = await askOnce(id, () => this.post(`/api/v1/requests/${id}/${action}`, {}));
    if (!answer) return;
    const { done, failed } = texts.ends[action];
    this.say(answer.ok ? done : failed(answer.detail));
    this.onAsked();
  }

  say(words) {
    setText(part(this.panel, "help-outcome"), words);
  }
}

// A press that was meant for the other end does not count.
function showEnd(button, action) {
  button.hidden = !action;
  if (!action || button.value === action) return;
  if (button.value) markNew(button);
  button.value = action;
  setText(button, texts.ends[action].words);
}

// The server keeps the request that is open, and its reason.
function outcomeText({ ok, detail, body }, { reason }) {
  if (!ok) return texts.failed(detail);
  return body.reason === reason ? texts.sent : texts.already(body.reason);
}
