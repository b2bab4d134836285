// What fills the robot's uplink, as the server measures it, and switches for what this page requests of it.

import { KeyedRows } from "../dom/keyedRows.js";
import { byTestId, make, makeButton, part, setText, sizeText } from "../dom/page.js";
import { uplink as texts } from "../texts/panels.js";

const EVERY_MS = 2000; // interval between two requests; the server measures over up to 5 s

/**
 * @typedef {{kind: string, name: string, bytes_per_s: number | null, people: number | null, yours: boolean, recorded?: boolean}} Stream
 * @typedef {{off: Set<string>, has: (name: string) => boolean, switchTo: (name: string, on: boolean) => void,
 *   note?: (name: string) => string}} Switch `note`: what this page knows besides
 */

// The rows of the list: what the server reports, and what is switched off here and not among that. Pure.
// `switches` by kind. `offers` "off" or "on" for what this page can switch, "" for the rest.
/** @param {Stream[]} streams @param {Record<string, Switch>} switches */
export function uplinkRows(streams, switches) {
  const isListed = (kind, name) => streams.some((stream) => stream.kind === kind && stream.name === name);
  /** @type {any[]} */
  const rows = streams.map((stream) => {
    const control = switches[stream.kind];
    return { ...stream, offers: offerOf(control, stream.name), note: control?.note?.(stream.name) ?? "" };
  });
  for (const [kind, { off }] of Object.entries(switches)) {
    for (const name of off) if (!isListed(kind, name)) rows.push({ kind, name, offers: "on" });
  }
  return rows;
}

function offerOf(control, name) {
  if (control?.off.has(name)) return "on";
  return control?.has(name) ? "off" : "";
}

const rateText = (bytes) => (bytes === null ? texts.unknown : texts.rate(sizeText(bytes)));

// Of all streams together; what is not known makes the sum unknown. `line` is what the line carries if it is full, else null.
export function totalText(streams, line) {
  const rates = streams.map(({ bytes_per_s: bytes }) => bytes);
  const total = texts.total(rateText(rates.includes(null) ? null : rates.reduce((sum, bytes) => sum + bytes, 0)));
  return line === null ? total : `${total} ${texts.full(rateText(line))}`;
}

// Of a stream that the server does not report only what this page does with it.
function factsOf({ kind, name, bytes_per_s: bytes, people = null, yours, recorded, offers, note = "" }) {
  const off = offers === "on" && texts.off;
  const readers = texts.people({ people, yours, recorded });
  return [name && (texts.kinds[kind] ?? kind), off, bytes !== undefined && rateText(bytes), readers, note];
}

export class Uplink {
  // `root` is the panel, always open if it is no <details>; `get()` gives an answer as of client/api.js; `switches` by kind.
  /** @param {any} root @param {{get: () => Promise<any>, switches?: Record<string, Switch>}} options */
  constructor(root, { get, switches = {} }) {
    this.root = root;
    this.get = get;
    this.switches = switches;
    this.streams = [];
    this.rows = new KeyedRows({
      container: part(root, "uplink-list"),
      keyOf: ({ kind, name }) => `${kind} ${name}`,
      make: (row) => this.build(row),
      fill: fillRow,
    });
    setText(part(root, "uplink-total"), texts.measuring);
    root.addEventListener("toggle", () => this.renew());
    document.addEventListener("visibilitychange", () => this.renew());
  }

  get isSeen() {
    return this.root.open !== false && !document.hidden;
  }

  async renew() {
    clearTimeout(this.timer);
    if (!this.isSeen || this.asking) return;
    this.asking = true;
    this.receive(await this.get());
    this.asking = false;
    if (this.isSeen) this.timer = setTimeout(() => this.renew(), EVERY_MS);
  }

  // Without an answer nothing is known any more of what was shown.
  receive({ ok, detail, body }) {
    const unknown = (stream) => ({ ...stream, bytes_per_s: null, people: null });
    this.streams = ok ? body.streams : this.streams.map(unknown);
    setText(part(this.root, "uplink-total"), ok ? totalText(this.streams, body.line_bytes_per_s) : texts.failed(detail));
    this.show();
  }

  show() {
    this.rows.showInPlace(uplinkRows(this.streams, this.switches));
  }

  build({ kind, name }) {
    const button = makeButton("uplink-switch", "", () => this.press(kind, name));
    const title = make("span", {}, name || texts.kinds[kind] || kind);
    const words = make("p", {}, title, make("small", { "data-part": "facts" }));
    return make("li", { "data-kind": kind, "data-name": name }, words, button);
  }

  press(kind, name) {
    const control = this.switches[kind];
    control.switchTo(name, control.off.has(name));
    this.show();
  }
}

function fillRow(element, row) {
  const { name, offers } = row;
  const button = byTestId(element, "uplink-switch");
  setText(part(element, "facts"), factsOf(row).filter(Boolean).join(" · "));
  button.hidden = !offers;
  if (!offers) return;
  setText(button, texts.offers[offers]);
  button.setAttribute("aria-label", texts.offer(offers, name));
}

// Ends what this page subscribes to of a topic, and begins it again; what reads the topic does not notice.
/** @implements {Switch} */
export class TopicSwitch {
  // `subscribe` as of connection.js; `probes` {has(name), close(name)} are those that the person opened, which end for good.
  constructor({ subscribe, probes }) {
    this.begin = subscribe;
    this.probes = probes;
    this.off = new Set();
    this.entries = new Set();
  }

  subscribe(spec, handler) {
    const entry = { spec, handler, end: /** @type {(() => void) | null} */ (null) };
    this.entries.add(entry);
    this.renew(entry);
    return () => {
      this.entries.delete(entry);
      entry.end?.();
    };
  }

  renew(entry) {
    const { spec, handler, end } = entry;
    const on = !this.off.has(spec.name);
    if (on && !end) entry.end = this.begin(spec, handler);
    if (on || !end) return;
    end();
    entry.end = null;
  }

  entriesOf(name) {
    return [...this.entries].filter(({ spec }) => spec.name === name);
  }

  has(name) {
    return this.entriesOf(name).length > 0 || this.probes.has(name);
  }

  switchTo(name, on) {
    const entries = this.entriesOf(name);
    if (on) this.off.delete(name);
    else if (entries.length) this.off.add(name);
    entries.forEach((entry) => this.renew(entry));
    if (!on && this.probes.has(name)) this.probes.close(name);
  }
}
