// The list of the robot's topics, and probes of one or two of them. Nothing is asked of the robot while the list is
// closed or the page is hidden.

import { hasWords, make, part, setText } from "../dom/page.js";
import { topics as texts } from "../texts/panels.js";
import { Inspector } from "./inspector.js";

const MAX_LISTED = 100;
const MAX_PROBES = 2;

// The topics whose name or type has all words, by name. Pure.
function matching(topics, query) {
  const fits = ({ name, type }) => hasWords(`${name} ${type}`, query);
  return topics.filter(fits).sort((a, b) => (a.name < b.name ? -1 : Number(a.name > b.name)));
}

export class Topics {
  // `root` is the panel, a <details>; `observerConnection` as of topicProbe.js; `ask()` has the robot asked for its topics again.
  constructor(root, { observerConnection, ask }) {
    this.root = root;
    this.observerConnection = observerConnection;
    this.ask = ask;
    this.topics = [];
    this.probes = new Map();
    this.live = false;
    this.search = part(root, "topic-search");
    this.list = part(root, "topic-list");
    root.addEventListener("toggle", () => this.toggle());
    this.search.addEventListener("input", () => this.show());
    part(root, "topic-ask").addEventListener("click", () => this.ask());
    document.addEventListener("visibilitychange", () => this.renew());
  }

  receive(topics) {
    this.topics = topics;
    this.show();
  }

  use({ live }) {
    this.live = live;
    this.renew();
  }

  toggle() {
    if (this.root.open) this.ask();
    this.renew();
    this.show();
  }

  renew() {
    this.observerConnection.use(this.live && this.root.open && !document.hidden);
  }

  show() {
    if (!this.root.open) return;
    const matches = matching(this.topics, this.search.value);
    const listed = matches.slice(0, MAX_LISTED);
    setText(part(this.root, "topic-count"), this.topics.length ? texts.count(matches.length, this.topics.length) : texts.none);
    setText(part(this.root, "topic-more"), matches.length > listed.length ? texts.more(matches.length - listed.length) : "");
    const content = listed.map(({ name, type }) => `${name} ${type}`).join("\n");
    if (content === this.content) return;
    this.content = content; // a list that is replaced for nothing loses the keyboard focus
    this.list.replaceChildren(...listed.map((topic) => make("li", {}, this.row(topic))));
  }

  row(topic) {
    const { name, type } = topic;
    const open = String(this.probes.has(name));
    const row = make(
      "button",
      { type: "button", "aria-pressed": open, "data-topic": name },
      make("span", {}, name),
      make("small", {}, type || texts.untyped),
    );
    row.addEventListener("click", () => (this.probes.has(name) ? this.closeProbe(name) : this.openProbe(topic)));
    return row;
  }

  openProbe(topic) {
    if (this.probes.size >= MAX_PROBES) this.closeProbe(this.probes.keys().next().value);
    const probe = new Inspector({
      topic,
      watch: (...how) => this.observerConnection.watch(...how),
      onClose: () => this.closeProbe(topic.name),
    });
    this.probes.set(topic.name, probe);
    part(this.root, "topic-looks").append(probe.element);
    this.mark(topic.name, true);
  }

  closeProbe(name) {
    const hadFocus = this.probes.get(name).element.contains(document.activeElement);
    this.probes.get(name).end();
    this.probes.delete(name);
    const row = this.mark(name, false);
    if (hadFocus) (row ?? this.search).focus({ preventScroll: true });
  }

  mark(name, open) {
    const row = [...this.list.querySelectorAll("button")].find(({ dataset }) => dataset.topic === name);
    row?.setAttribute("aria-pressed", String(open));
    return row;
  }
}
