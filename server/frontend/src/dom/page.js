// What all pages share: small helpers around the document, and what the browser keeps for the next visit.

export const part = (root, name) => root.querySelector(`[data-part="${name}"]`);

export const byTestId = (root, name) => root.querySelector(`[data-testid="${name}"]`);

// Where text is typed, and all that takes letters for itself.
export const TEXT = "input:not([type=range]):not([type=checkbox]), textarea, [contenteditable]";
export const TYPING = `${TEXT}, select`;
export const FIELDS = `${TYPING}, input`;

export const matches = (target, selector) => Boolean(target?.closest?.(selector));

// Whether a press asks for the list of keys, and is no character of a text.
export const asksForKeys = ({ key, ctrlKey, metaKey, altKey, target }) =>
  key === "?" && !(ctrlKey || metaKey || altKey) && !matches(target, TEXT);

// From here on the page does what its markup promises. While a server is upgraded, that may be of the release before.
export function noteScript(page = document) {
  page.body.dataset.scripted = "true";
  part(page, "unscripted")?.remove();
}

// What the browser's Back shows of a page that it kept is as old as that.
export function reloadOnReturn(target = window, reload = () => location.reload()) {
  target.addEventListener("pageshow", ({ persisted }) => persisted && reload());
}

// Writes only what changed, so that live regions and layout stay quiet.
export function setText(element, text) {
  if (element && element.textContent !== text) element.textContent = text;
}

// The same of any member.
export function setIfOther(target, name, value) {
  if (target[name] !== value) target[name] = value;
}

const clock = (time, seconds) => time.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit", second: seconds });

// The time of day, with the date before it when that is not today. Empty for no time.
export function localTime(iso, now = new Date()) {
  if (!iso) return "";
  const time = new Date(iso);
  if (time.toDateString() === now.toDateString()) return clock(time);
  return `${time.toLocaleDateString("en-GB", { day: "numeric", month: "short" })} ${clock(time)}`;
}

// A time of a list or a record: day and time with seconds.
export const localTimestamp = (iso, now = new Date()) => `${dayText(new Date(iso), now)} ${clock(new Date(iso), "2-digit")}`;

// Writes the page's times in the reader's zone. Their titles stay in UTC, as all of them are without scripts.
export function showLocalTimes(page, now = new Date()) {
  for (const time of page.querySelectorAll("time[datetime]")) setText(time, localTimestamp(time.dateTime, now));
}

const fresh = { asked: 0, given: 0 }; // pages

// A page as the server has it now; null without an answer, or if a later one came first. A login that has ended has another page.
export async function freshPage(path) {
  const number = ++fresh.asked;
  const read = async () => {
    const answer = await fetch(path, { cache: "no-store" });
    return answer.ok ? answer.text() : null;
  };
  const text = await read().catch(() => null);
  if (text === null || number < fresh.given) return null;
  fresh.given = number;
  const page = new DOMParser().parseFromString(text, "text/html");
  showLocalTimes(page);
  return page;
}

// The year only when it is another one.
function dayText(time, now) {
  const daysAgo = (days) => new Date(now.getFullYear(), now.getMonth(), now.getDate() - days).toDateString();
  const recent = ["today", "yesterday"].find((_, days) => time.toDateString() === daysAgo(days));
  const year = time.getFullYear() === now.getFullYear() ? undefined : "numeric";
  return recent ?? time.toLocaleDateString("en-GB", { day: "numeric", month: "short", year });
}

// The same in UTC, as lists have it on hover. Empty for no time.
export const utcTimestamp = (iso) => (iso ? `${new Date(iso).toISOString().slice(0, 19).replace("T", " ")} UTC` : "");

// Whether the text has each of the typed words, in any order.
export function hasWords(text, typed) {
  const words = typed.toLowerCase().split(/\s+/);
  return words.every((word) => text.toLowerCase().includes(word));
}

// A number as people read one: with the digits that count.
export function shortNumber(value) {
  if (!Number.isFinite(value)) return "-";
  const size = Math.abs(value);
  if (size >= 1e9 || (value !== 0 && size < 1e-3)) return value.toExponential(2);
  return size >= 1000 ? String(Math.round(value)) : String(Number(value.toPrecision(3)));
}

// A number with these decimals; one that is too large for its place with its power of ten.
export function decimalText(value, decimals) {
  if (Math.abs(value) >= 1e5) return value.toExponential(1);
  return (Number(value.toFixed(decimals)) + 0).toFixed(decimals); // + 0 turns -0 into 0
}

/** @type {[string, number][]} */
const UNITS = [
  ["GB", 1e9],
  ["MB", 1e6],
  ["KB", 1e3],
];

export function sizeText(bytes) {
  const [unit, size] = UNITS.find(([, least]) => bytes >= least) ?? ["B", 1];
  return `${size === 1 ? bytes : (bytes / size).toFixed(bytes < 9.95 * size ? 1 : 0)} ${unit}`;
}

// "2 h 3 min", "2 min 5 s", "5 s".
export function durationText(ms) {
  const seconds = Math.max(0, Math.round(ms / 1000));
  const [hours, minutes] = [Math.floor(seconds / 3600), Math.floor((seconds % 3600) / 60)];
  if (hours) return `${hours} h ${minutes} min`;
  return minutes ? `${minutes} min ${seconds % 60} s` : `${seconds} s`;
}

// Makes an element with attributes and children; a child that is a text stays a text.
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

// Makes a button with a test id; `act` comes with each press.
export function makeButton(testId, text, act, attributes = {}) {
  const button = make("button", { type: "button", "data-testid": testId, ...attributes }, text);
  button.addEventListener("click", act);
  return button;
}

// Hides or shows buttons. One that goes while it has the focus hands it to the first that is there, else to `last`, or the next
// Tab would begin at the top.
export function keepFocus(change, buttons, last) {
  const focused = /** @type {HTMLElement | null} */ (document.activeElement);
  change();
  if (focused?.hidden) (buttons.find(({ hidden }) => !hidden) ?? last).focus({ preventScroll: true }); // which would move the stick
}

// What an element holds, to compare it with another answer's: each has its own token in its forms.
export const withoutTokens = (element) => element.innerHTML.replace(/(name="csrf_token" value=")[^"]*/g, "$1");

// What narrows a list is behind one button on a phone; elsewhere the style sheet shows it always.
export function foldFilters(root, opened) {
  const button = part(root, "filters");
  const open = (opens) => {
    root.dataset.open = String(opens);
    button.setAttribute("aria-expanded", String(opens));
  };
  button.addEventListener("click", () => open(root.dataset.open === "false"));
  open(opened);
}

// Saves it as a file of this name.
export function download(blob, name) {
  const url = URL.createObjectURL(blob);
  make("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000); // the browser has taken it up long before
}

// What a person chose on this device, kept for the next visit. A browser that keeps nothing is no error.
const PREFIX = "robotether.";

export class LocalStore {
  constructor(storage = () => globalThis.localStorage) {
    this.storage = storage; // even asking for it throws where it is blocked
  }

  // What was kept under this name, or null.
  read(name) {
    try {
      return JSON.parse(this.storage().getItem(PREFIX + name) ?? "null");
    } catch {
      return null;
    }
  }

  write(name, value) {
    this.attempt((storage) => storage.setItem(PREFIX + name, JSON.stringify(value)));
  }

  forget(name) {
    this.attempt((storage) => storage.removeItem(PREFIX + name));
  }

  attempt(act) {
    try {
      act(this.storage());
    } catch {
      // Full or blocked: the choice then lasts as long as the page.
    }
  }
}

const objectOf = (value) => (value !== null && typeof value === "object" ? value : {});

// What a person chose for one part of a page, as an object that is kept under one name.
export class Choices {
  constructor(name, store = new LocalStore()) {
    this.name = name;
    this.store = store;
    this.all = objectOf(store.read(name));
  }

  // Those that are kept together, as an object, whatever an older release or a hand left there.
  group(name) {
    return objectOf(this.all[name]);
  }

  keep(choices) {
    this.all = { ...this.all, ...choices };
    this.store.write(this.name, this.all);
  }
}
