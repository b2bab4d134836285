// Which robots the fleet page shows, and in which order: kept in the page's address, so that it can be passed on. Pure.

import { hasWords } from "../dom/page.js";
import { attention } from "./cards.js";

const collator = new Intl.Collator("en", { numeric: true });

const IN_STATE = {
  online: ({ online }) => online,
  driven: ({ control }) => Boolean(control?.driver),
  stopped: ({ control }) => Boolean(control?.stopped),
  attention: (robot) => attention(robot).length > 0,
};
const STATES = Object.keys(IN_STATE);

// What a robot is sorted by; a robot without one comes last in either order.
const NUMBERS = {
  battery: ({ battery }) => battery?.percent ?? null,
  rtt: ({ online, rtt_ms }) => (online ? (rtt_ms ?? null) : null),
};
const TEXTS = {
  name: ({ name }) => name,
  driver: ({ control }) => control?.driver?.user || null,
  site: ({ site }) => site || null,
};
const SORTS = ["state", "name", ...Object.keys(NUMBERS), "driver", "site"];

// {words, site, states, sort, down}; `site` null is every site and "" none.
export function fromQuery(query) {
  const choices = new URLSearchParams(query);
  const states = (choices.get("show") ?? "").split(",").filter((state) => STATES.includes(state));
  const sort = choices.get("sort") ?? "";
  const isSort = SORTS.includes(sort.replace(/^-/, ""));
  return {
    words: choices.get("q") ?? "",
    site: choices.get("site"),
    states: [...new Set(states)],
    sort: isSort ? sort.replace(/^-/, "") : "state",
    down: isSort && sort.startsWith("-"),
  };
}

// What is usual is left out.
export function toQuery({ words, site, states, sort, down }) {
  const query = new URLSearchParams();
  if (words.trim()) query.set("q", words.trim());
  if (site !== null) query.set("site", site);
  if (states.length) query.set("show", states.join(","));
  if (sort !== "state" || down) query.set("sort", (down ? "-" : "") + sort);
  const text = query.toString().replaceAll("%2C", ",");
  return text && `?${text}`;
}

export const isFiltered = ({ words, site, states }) => Boolean(words.trim() || site !== null || states.length);

// The function that says whether a robot fits all that is asked for.
export function filterOf({ words, site, states }) {
  return (robot) =>
    (site === null || (robot.site ?? "") === site) && states.every((state) => IN_STATE[state](robot)) && hasWords(textOf(robot), words);
}

const textOf = ({ name, site, control }) => `${name} ${site ?? ""} ${control?.driver?.user ?? ""}`;

// Names as a person counts: sim2 before sim10.
export const inNameOrder = (names) => [...names].sort(collator.compare);

// Robots that come in the order of their names, in another order: equals stay as they came.
export function inOrder(robots, { sort, down }) {
  return [...robots].sort(comparison(sort, down ? -1 : 1));
}

export const WINDOW = 50; // Number of rows that a long list shows at first, and that each press adds.

// The first of those rows that fit, and how many follow them.
export function inWindow(rows, fits, length) {
  const fitting = rows.filter(fits);
  return { shown: new Set(fitting.slice(0, length)), left: Math.max(fitting.length - length, 0) };
}

function comparison(sort, way) {
  if (sort === "state") return (a, b) => way * (Number(b.online) - Number(a.online));
  const value = NUMBERS[sort] ?? TEXTS[sort];
  const order = sort in NUMBERS ? (a, b) => a - b : collator.compare;
  return (a, b) => {
    const [first, second] = [value(a), value(b)];
    if (first === null || second === null) return Number(first === null) - Number(second === null);
    return way * order(first, second);
  };
}

// The sites of these robots, in order; "" last, where one has none. Pure.
export function sitesOf(robots) {
  const sites = [...new Set(robots.map(({ site }) => site ?? ""))];
  return sites.sort((a, b) => Number(a === "") - Number(b === "") || collator.compare(a, b));
}
