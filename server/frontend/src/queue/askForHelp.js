// Asking for help on the drive page, in its drawer, and what is asked for now. It must never touch what drives.

import { robotPath } from "../client/api.js";
import { KeyedRows } from "../dom/keyedRows.js";
import { make, makeButton, part, setText } from "../dom/page.js";
import { askOnce } from "../dom/presses.js";
import { help as texts } from "../texts/queue.js";
import { keyOfRequest, requestFacts } from "./requestRows.js";

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
    this.mayWithdraw = ({ source, asked_by: asker }) => level === "manage" || (asker === me && BY_PEOPLE.includes(source));
    this.panel = part(root, "help");
    this.form = part(root, "help-form"); // who only watches has none
    this.list = part(this.panel, "help-list");
    this.rows = new KeyedRows({ container: this.list, keyOf: keyOfRequest, make: (request) => this.make(request), fill: fillItem });
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
    setText(part(this.root, "help-badge"), open.length ? texts.open : "");
    part(this.root, "help-badge").hidden = open.length === 0;
    setText(part(this.panel, "help-state"), requests ? "" : texts.unknown);
    const hadFocus = this.list.contains(document.activeElement);
    this.rows.showInPlace(open);
    if (hadFocus && !this.list.contains(document.activeElement)) part(this.root, "drawer").focus({ preventScroll: true });
  }

  make(request) {
    const withdraw = makeButton("help-withdraw", texts.withdraw, () => this.withdraw(request.id));
    withdraw.hidden = !this.mayWithdraw(request);
    const words = [make("span", { "data-part": "reason" }), make("small", { "data-part": "facts" })];
    return make("li", {}, make("p", {}, ...words), withdraw);
  }

  async withdraw(id) {
    const answer = await askOnce(id, () => this.post(`/api/v1/requests/${id}/cancel`));
    if (!answer) return;
    this.say(answer.ok ? texts.cancelled : texts.notWithdrawn(answer.detail));
    this.onAsked();
  }

  say(words) {
    setText(part(this.panel, "help-outcome"), words);
  }
}

function fillItem(element, request) {
  const { reason, priority, state, age } = requestFacts(request);
  setText(part(element, "reason"), reason);
  setText(part(element, "facts"), [priority, state, age].join(" · "));
}

// The server keeps the request that is open, and its reason.
function outcomeText({ ok, detail, body }, { reason }) {
  if (!ok) return texts.failed(detail);
  return body.reason === reason ? texts.sent : texts.already(body.reason);
}
