// Sentences of the page Health. No logic beyond filling in.

import { sentence } from "./common.js";

const UNKNOWN = "unknown";

export const health = {
  unknown: UNKNOWN,
  states: { good: "Good", bad: "Fault", unknown: "Unknown" },
  nothingToDo: "Nothing",
  alerts: {
    unknown: "Alerts are unknown: they need the profile metrics.",
    none: "No alert is firing.",
    some: (count) => (count === 1 ? "1 alert is firing:" : `${count} alerts are firing:`),
  },
};

export const history = {
  loading: "Reading the history",
  needsProfile: "History needs the profile metrics: set COMPOSE_PROFILES=metrics, or wait until Prometheus answers.",
  failed: (detail) => (detail ? sentence(detail) : "The server does not answer."),
  of: (robot, range) => `${robot || "All robots"}, ${range}.`,
  ranges: { hour: "the last hour", day: "the last day", week: "the last week" },
  noData: "Unknown for all of this time.",
  titles: {
    robots_online: "Robots online",
    online: "Online (1) or not (0)",
    seen_age: "Age of what drivers see",
    round_trip: "Round trip",
    guard_stops: "Stops by guards",
    frames: "Video frames",
    video: "Video data",
    requests_waiting: "Requests for help that wait",
    refused_logins: "Log-ins refused",
    web_errors: "Pages and API: server errors",
    battery: "Battery",
  },
  lines: { p50: "half within", p99: "99 % within", silence: "no command", lost: "driver lost", fault: "fault", person: "by people" },
  units: {
    count: (text) => text,
    per_s: (text) => `${text} /s`,
    milliseconds: (text) => `${text} ms`,
    seconds: (text) => `${text} s`,
    bits_per_s: (text) => `${text} Mbit/s`,
    percent: (text) => `${text} %`,
  },
  noLine: (name) => `${name}: unknown for all of this time`,
  line: ({ name, now, least, most }) => `${name ? `${name}: ` : ""}now ${now}, lowest ${least}, highest ${most}`,
  gaps: (percent) => `, unknown for ${percent} % of the time`,
};
