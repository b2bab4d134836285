// What is known of a drive at one time of its recording, in words. Nothing is shown that the recording does not have: what is old, or
// not there, is not recorded. Pure.

import { limits } from "../texts/common.js";
import { replay as texts } from "../texts/replay.js";

export const COMMANDS = "/robotether/commands";
export const CONTROL = "/robotether/control";
export const SEEN_AGES = "/robotether/seen_ages";
export const ROUND_TRIPS = "/robotether/round_trips";

const RECENT_MS = 1500; // for which a message says what is the case; round trips come each two seconds
const COMMAND_MS = 500; // commands come at 20 Hz, and the guard drops older ones
const ROUND_TRIP_MS = 4000;
const MAX_NAME = 100;
const MAX_EVENTS = 200;

const isKnown = (value) => typeof value === "number" && Number.isFinite(value);
const ms = (value) => (isKnown(value) ? texts.ms(value) : texts.notRecorded);
const nameText = (value) => (typeof value === "string" && value ? value.slice(0, MAX_NAME) : "");

export class DriveState {
  constructor() {
    this.reset();
  }

  reset() {
    /** @type {Map<string, {message: any, atMs: number}>} */
    this.newest = new Map();
  }

  // `message` as it was decoded, by topic; `kind` "measured" {forward, left, turn} and "frame" {ageMs} are not topics.
  receive(kind, message, atMs) {
    this.newest.set(kind, { message, atMs });
  }

  recent(kind, atMs, withinMs = RECENT_MS) {
    const newest = this.newest.get(kind);
    return newest && atMs - newest.atMs <= withinMs && atMs >= newest.atMs ? newest.message : null;
  }

  // By the parts of the page. `control` is the message of that topic that holds, null for unknown.
  words(atMs, control) {
    const seen = this.recent(SEEN_AGES, atMs);
    return {
      ...controlWords(control),
      ...commandWords(this.recent(COMMANDS, atMs, COMMAND_MS), control ? texts.noCommand : texts.notRecorded),
      measured: measuredText(this.recent("measured", atMs)),
      limit: limitText(seen),
      "seen-age": ms(oldest(seen?.ages_ms)),
      "frame-age": ms(this.recent("frame", atMs)?.ageMs),
      "round-trip": roundTripText(this.recent(ROUND_TRIPS, atMs, ROUND_TRIP_MS)),
    };
  }
}

// Null from where the recorder did not hear the relay, or that had not the robot: the recorder writes a fence of -1.
export const knownControl = (control) => (control && control.fence >= 0 ? control : null);

function controlWords(control) {
  if (!control) return { driver: texts.notRecorded, state: texts.notRecorded };
  return { driver: nameText(control.driver) || texts.nobody, state: stateText(control) };
}

function commandWords(command, without) {
  if (!command) return { asked: without, outcome: without, "command-age": texts.notRecorded };
  const { speed_m_s: speed, turn_rad_s: turn, outcome, age_ms: age } = command;
  return { asked: speedText(speed, turn), outcome: texts.outcomes[outcome] ?? nameText(outcome), "command-age": ms(age) };
}

const roundTripText = (trip) => (trip ? texts.roundTrip(ms(trip.driver_ms), ms(trip.robot_ms)) : texts.notRecorded);

// One age that is not known makes the oldest unknown.
function oldest(ages) {
  return Array.isArray(ages) && ages.length && ages.every(isKnown) ? Math.max(...ages) : null;
}

function stateText({ online, stopped, stopped_by: by, stop_confirmed: confirmed }) {
  if (stopped) return texts.stopped(nameText(by), Boolean(confirmed));
  return online ? texts.online : texts.offline;
}

const speedText = (speed, turn) =>
  [isKnown(speed) && limits.linear(speed), isKnown(turn) && limits.angular(turn)].filter(Boolean).join(", ") || texts.notRecorded;

function measuredText(measured) {
  if (!measured) return texts.notRecorded;
  const { forward, left, turn } = measured;
  const isWhole = isKnown(forward) && isKnown(left);
  return speedText(isWhole ? (left ? Math.hypot(forward, left) : forward) : null, turn);
}

function limitText(seen) {
  if (!seen || !isKnown(seen.slowed_s)) return texts.notRecorded;
  if (!seen.slowed_s) return texts.notSlowed;
  const words = [
    isKnown(seen.max_speed_m_s) && limits.linear(seen.max_speed_m_s),
    isKnown(seen.max_turn_rad_s) && limits.angular(seen.max_turn_rad_s),
  ];
  return texts.slowed(words.filter(Boolean).join(", "));
}

// What changed: `controls` are [{atMs, message, isMore}] in their order, a message null from where it is unknown, the last with `isMore`
// where others follow, `recorded` the spans in which anything is. Gives {events: [{atMs, text}], isMore, stops, drives}, the last two as
// spans.
export function historyOf(controls, recorded) {
  const events = [];
  /** @type {any} */
  let before;
  for (const { atMs, message, isMore } of controls) {
    for (const text of wordsOf(before, message, isMore)) events.push({ atMs, text });
    before = message;
  }
  const isCut = controls.at(-1)?.isMore;
  const spans = (holds) => spansOf(controls, recorded, holds);
  return {
    events: events.slice(0, MAX_EVENTS),
    isMore: events.length > MAX_EVENTS || Boolean(isCut),
    stops: spans(({ stopped }) => stopped),
    drives: spans(({ driver }) => driver),
  };
}

function wordsOf(before, message, isMore) {
  if (!message) return before === null || isMore ? [] : [texts.unknownFrom];
  return before ? changes(before, message) : firstWords(message);
}

const firstWords = (control) => [control.driver && driverWords(control), control.stopped && stopWords(control)].filter(Boolean);

function changes(before, after) {
  const isOther = (name) => before[name] !== after[name];
  return [
    isOther("driver") && driverWords(after),
    isOther("stopped") && stopWords(after),
    isOther("stop_confirmed") && after.stop_confirmed && texts.stopConfirmed,
    isOther("online") && (after.online ? texts.wentOnline : texts.wentOffline),
  ].filter(Boolean);
}

const driverWords = ({ driver }) => (driver ? texts.drives(nameText(driver)) : texts.nobodyDrives);

const stopWords = ({ stopped, stopped_by: by }) => (stopped ? texts.wasStopped(nameText(by)) : texts.released);

// In a gap nobody knows whether it still held.
function spansOf(controls, recorded, holds) {
  return controls.flatMap(({ atMs, message }, i) => {
    if (!message || !holds(message)) return [];
    const next = controls[i + 1]?.atMs ?? Infinity;
    const spans = recorded.map(({ fromMs, toMs }) => ({ fromMs: Math.max(fromMs, atMs), toMs: Math.min(toMs, next) }));
    return spans.filter(({ fromMs, toMs }) => fromMs < toMs);
  });
}
