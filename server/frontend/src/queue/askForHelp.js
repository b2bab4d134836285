// Asking for help on the drive page, in its drawer, and what is asked for now. It must never touch what drives.

import { make, makeButton, part, setText } from "../dom/page.js";
import { AskedOnce } from "../dom/presses.js";
import { help as texts } from "../texts/queue.js";
import { requestFacts } from "./requestRows.js";

const NORMAL = 2;
const URGENT = 1;
const BY_PEOPLE = ["api", "page"]; // sources of requests that name a user; a robot may have the same name

export class AskForHelp {
  // `root` is the body: the drawer has the form and the list, the header says that something is open. `post(path, body)` as of
  // client/api.js; `onAsked()` asks for the list anew.
  constructor(root, { robot, me, level, post, onAsked }) {
    this.root = root;
    this.robot = robot;
    this.post = post;
    this.onAsked = onAsked;
    this.mayWithdraw = ({ source, asked_by: asker }) => level === "manage" || (asker === me && BY_PEOPLE.includes(source));
    this.panel = part(root, "help");
    this.form = part(root, "help-form"); // who only watches has none
    this.items = new Map();
    this.withdrawals = new AskedOnce();
    this.form?.addEventListener("submit", (event) => this.ask(event));
  }

  async ask(event) {
    event.preventDefault();
    const reason = part(this.form, "help-reason");
    const urgent = part(this.form, "help-urgent");
    const body = { reason: reason.value.trim(), priority: urgent.checked ? URGENT : NORMAL };
    const answer = await this.post(`/api/v1/robots/${encodeURIComponent(this.robot)}/requests`, body);
    this.say(outcomeText(answer, body));
    if (!answer.ok) return;
    reason.value = "";
    urgent.checked = false;
    this.onAsked();
  }

  // `requests` are the robot's open ones, or null where that is not known.
  receive(requests) {
    const open = requests ?? [];
    setText(part(this.root, "help-badge"), open.length ? texts.open : "");
    part(this.root, "help-badge").hidden = open.length === 0;
    setText(part(this.panel, "help-state"), requests ? "" : texts.unknown);
    const ids = new Set(open.map(({ id }) => id));
    for (const [id, item] of this.items) if (!ids.has(id)) this.remove(id, item);
    for (const request of open) this.show(request);
  }

  show(request) {
    const item = this.items.get(request.id) ?? this.add(request);
    const { reason, priority, state, age } = requestFacts(request);
    setText(item.words, reason);
    setText(item.facts, [priority, state, age].join(" · "));
  }

  add(request) {
    const { id } = request;
    const [words, facts] = [make("span"), make("small")];
    const withdraw = makeButton("help-withdraw", texts.withdraw, () => this.withdraw(id));
    withdraw.hidden = !this.mayWithdraw(request);
    const element = make("li", {}, make("p", {}, words, facts), withdraw);
    part(this.panel, "help-list").append(element);
    const item = { element, words, facts };
    this.items.set(id, item);
    return item;
  }

  remove(id, { element }) {
    if (element.contains(document.activeElement)) part(this.root, "drawer").focus({ preventScroll: true });
    element.remove();
    this.items.delete(id);
  }

  async withdraw(id) {
    const answer = await this.withdrawals.run(id, () => this.post(`/api/v1/requests/${id}/cancel`));
    if (!answer) return;
    this.say(answer.ok ? texts.cancelled : texts.notWithdrawn(answer.detail));
    this.onAsked();
  }

  say(words) {
    setText(part(this.panel, "help-outcome"), words);
  }
}

// The server keeps the request that is open, and its reason.
function outcomeText({ ok, detail, body }, { reason }) {
  if (!ok) return texts.failed(detail);
  return body.reason === reason ? texts.sent : texts.already(body.reason);
}
