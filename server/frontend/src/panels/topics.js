// The list of the robot's topics, and looks at one or two of them. Nothing is asked of the robot while the list is
// closed or the page is hidden.

import { make, part, setText } from "../page.js";
import { topics as texts } from "../texts/panels.js";
import { Inspector } from "./inspector.js";

const MOST_SHOWN = 100;
const MOST_LOOKS = 2;

// The topics whose name or type has all words, by name. Pure.
export function matching(topics, query) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  const fits = ({ name, type }) => words.every((word) => `${name} ${type}`.toLowerCase().includes(word));
  return topics.filter(fits).sort((a, b) => (a.name < b.name ? -1 : Number(a.name > b.name)));
}

export class Topics {
  // `root` is the panel, a <details>; `lookout` as of lookout.js; `ask()` has the robot asked for its topics again.
  constructor(root, { lookout, ask }) {
    Object.assign(this, { root, lookout, ask });
    this.topics = [];
    this.looks = new Map();
    this.live = false;
    this.search = part(root, "topic-search");
    this.list = part(root, "topic-list");
    root.addEventListener("toggle", () => this.toggle());
    this.search.addEventListener("input", () => this.show());
    part(root, "topic-ask").addEventListener("click", () => this.ask());
    document.addEventListener("visibilitychange", () => this.renew());
  }

  hear(topics) {
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
    this.lookout.use(this.live && this.root.open && !document.hidden);
  }

  show() {
    if (!this.root.open) return;
    const found = matching(this.topics, this.search.value);
    const shown = found.slice(0, MOST_SHOWN);
    setText(part(this.root, "topic-count"), this.topics.length ? texts.count(found.length, this.topics.length) : texts.none);
    setText(part(this.root, "topic-more"), found.length > shown.length ? texts.more(found.length - shown.length) : "");
    const wanted = shown.map(({ name, type }) => `${name} ${type}`).join("\n");
    if (wanted === this.shown) return;
    this.shown = wanted; // a list that is replaced for nothing loses the keyboard focus
    this.list.replaceChildren(...shown.map((topic) => make("li", {}, this.row(topic))));
  }

  row(topic) {
    const { name, type } = topic;
    const open = String(this.looks.has(name));
    const row = make("button", { type: "button", "aria-pressed": open, "data-topic": name }, make("span", {}, name), make("small", {}, type || texts.untyped));
    row.addEventListener("click", () => (this.looks.has(name) ? this.closeLook(name) : this.openLook(topic)));
    return row;
  }

  openLook(topic) {
    if (this.looks.size >= MOST_LOOKS) this.closeLook(this.looks.keys().next().value);
    const look = new Inspector({
      topic,
      watch: (...how) => this.lookout.watch(...how),
      onClose: () => this.closeLook(topic.name),
    });
    this.looks.set(topic.name, look);
    part(this.root, "topic-looks").append(look.element);
    this.mark(topic.name, true);
  }

  closeLook(name) {
    const hadFocus = this.looks.get(name).element.contains(document.activeElement);
    this.looks.get(name).end();
    this.looks.delete(name);
    const row = this.mark(name, false);
    if (hadFocus) (row ?? this.search).focus({ preventScroll: true });
  }

  mark(name, open) {
    const row = [...this.list.querySelectorAll("button")].find(({ dataset }) => dataset.topic === name);
    row?.setAttribute("aria-pressed", String(open));
    return row;
  }
}
