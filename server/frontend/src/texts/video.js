// Sentences of the pages: video, overlays, battery and diagnostics. No logic beyond filling in.

import { because } from "./common.js";

// The reason as it was written where it is known best, else the usual one; then what the page does.
const reason =
  (usual, then = "") =>
  (/** @type {string} */ detail = "") =>
    (detail ? because(detail) : usual) + then;

const CODECS = { h264: "H.264", vp8: "VP8", jpeg: "JPEG" };

export const frame = {
  of: (name) => `Live video of ${name}`,
  old: "This video is old.",
  age: (ms) => (ms < 10_000 ? `${Math.round(ms)} ms` : `${Math.round(ms / 1000)} s old`),
  rate: (perSecond) => `${perSecond.toFixed(1)}/s`,
  quality: (percent) => `${percent} %`,
  size: ({ width, height }) => `${width}×${height}`,
  codec: (codec) => CODECS[codec] ?? "",
  // `reason`: why the robot does not encode, or not all; `isOnly`: this browser decodes nothing else.
  encoding: ({ codec, encoder, reason, isOnly }) => {
    if (codec === "jpeg" && isOnly) return "JPEG: this browser decodes nothing else here.";
    const name = encoder && codec !== "jpeg" ? `${CODECS[codec]}, encoded by ${encoder}` : CODECS[codec];
    return reason ? `${name}: ${because(reason)}` : name;
  },
  enlarge: (name) => `Show ${name} large`,
  // Why there is no new frame, by the words of client/frames.js.
  why: {
    starting: () => "Waiting for the first frame.",
    waiting: () => "The camera sends no video.",
    undecodable: () => "The camera's frames cannot be decoded.",
    down: reason("The camera does not answer."),
    paused: () => "Paused while this page is in the background.",
    off: () => "Switched off in the menu, Uplink.",
    old: () => "",
    robot_offline: reason("The robot is offline."),
    video_down: reason("The robot's video server does not answer."),
    login_missing: () => "Your login has ended.",
    rights_ended: reason("Your rights have changed."),
    gone: () => "This robot is not here any more.",
    crowded: reason("Too many windows show this camera."),
    slow: reason("This device receives the video too slowly.", " Starting it again."),
    restarting: reason("The server is restarting."),
    link_lost: reason("The link to the robot was lost.", " Reconnecting."),
    cut: reason("The video was cut off.", " Starting it again."),
    unreachable: reason("The server does not answer.", " Trying again."),
    refused: because,
  },
};

const TOPIC_KINDS = { scan: "laser scan", located: "localization", tfStatic: "static frames", tf: "frames" };

const MOST_NAMED = 4; // maximum number of topics that a question names.

function someOf(names) {
  const left = names.length - MOST_NAMED;
  return [...names.slice(0, MOST_NAMED), ...(left > 0 ? [`${left} more`] : [])].join(" or ");
}

export const video = {
  map: "Map",
  mapRefused: (why) => `Map not shown. ${because(why)}`,
  topicInDoubt: (kind, candidates) =>
    `Which ${TOPIC_KINDS[kind] ?? kind} topic is this robot's: ${someOf(candidates)}? A manager chooses it in the robot's settings.`,
  unread: (topic) => `A message of ${topic} could not be read, so it is not shown.`,
  snapshotSaved: "Picture saved.",
  snapshotFailed: (status, detail) =>
    `Picture not saved. ${because(detail || (status ? `the server answered ${status}` : "no answer; try again"))}`,
};

export const map = {
  label: "The robot from above",
  nothing: "Nothing to draw yet.",
  unread: "The robot's newest map cannot be read.",
  lost: "Where the robot is in the map is unknown.",
  silentScan: "The laser is silent.",
  pose: (x, y, degrees) => `x ${x} m, y ${y} m, ${degrees}°`,
  scale: (metres) => `${metres} m`,
};

export const ring = { silent: "No laser" };

export const battery = { none: "-" };

export const diagnostics = {
  ok: () => "Diagnostics OK",
  warn: (count) => (count === 1 ? "1 warning" : `${count} warnings`),
  error: (count) => (count === 1 ? "1 error" : `${count} errors`),
  stale: (count) => (count === 1 ? "1 part is silent" : `${count} parts are silent`),
  more: (count) => `${count} more, none of them worse`,
  newest: (words, most) => `${words}, of the newest ${most} parts`,
  levels: { ok: "OK", warn: "Warning", error: "Error", stale: "Silent" },
};
