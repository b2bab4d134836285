// Says whether another machine of the site answers this browser clearly sooner than the one that the page came from, and links to
// it. What a person does travels through the machine that has the page.

import { withTimeLimit } from "../client/api.js";
import { nearest as texts } from "../texts/fleet.js";
import { setText } from "../dom/page.js";

// Served by nginx itself, so it costs the round trip alone.
const PATH = "/nginx-health";
const TRIPS = 3; // number of round trips of which the shortest counts: the first opens the connection
const TIMEOUT_MS = 5000; // time limit for all round trips to a machine
const CLEAR_GAIN_MS = 20; // least gain, and its least share of what it is here, as robots have it
const CLEAR_GAIN = 0.2;

// `element` has the other machines in data-machines: JSON, [{name, authority}].
export async function showNearest(element, measure = measureRoundTrip) {
  setText(element, texts.measuring);
  const machines = JSON.parse(element.dataset.machines);
  const [hereMs, ...othersMs] = await Promise.all(["", ...machines.map(originOf)].map(measure));
  const { machine, ms } = nearestOf(hereMs, machines, othersMs);
  if (!machine) return setText(element, hereMs === null ? texts.unknown : texts.here(hereMs));
  setText(element, texts.nearer(machine.name, ms, hereMs));
  const link = document.createElement("a");
  Object.assign(link, { href: `${originOf(machine)}/`, textContent: texts.open(machine.name) });
  element.append(" ", link);
}

const originOf = ({ authority }) => `https://${authority}`;

// The machine that is clearly nearer than here, if there is one: {machine, ms}. A round trip is null for none measured. Pure.
/** @returns {{ machine?: any, ms?: any }} */
export function nearestOf(hereMs, machines, othersMs) {
  const measured = machines.map((machine, at) => ({ machine, ms: othersMs[at] })).filter(({ ms }) => ms !== null);
  const [first] = measured.sort((one, other) => one.ms - other.ms);
  if (hereMs === null || !first) return {};
  const gain = hereMs - first.ms;
  return gain >= CLEAR_GAIN_MS && gain >= CLEAR_GAIN * hereMs ? first : {};
}

// Milliseconds to an origin and back, "" for the page's own; null: it did not answer, or the browser does not trust it.
async function measureRoundTrip(origin) {
  /** @type {number | null} */
  let shortest = null;
  const measure = async (signal) => {
    for (let trip = 0; trip < TRIPS; trip++) {
      const began = performance.now();
      await fetch(origin + PATH, { mode: "no-cors", cache: "no-store", credentials: "omit", signal });
      shortest = Math.min(shortest ?? Infinity, performance.now() - began);
    }
  };
  await withTimeLimit(TIMEOUT_MS, measure).catch(() => {}); // what was measured until then is a round trip, too
  return shortest;
}
