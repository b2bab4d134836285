// Sentences of the pages: buttons, topics, uplink and the summary of a drive. No logic beyond filling in.

import { notDone, sentence } from "./common.js";

export const buttons = {
  idle: "",
  asking: "",
  pending: "Waiting",
  sent: "Sent",
  done: "Done",
  failed: "Failed",
  unknown: "Unknown",
  hint: (usable) => (usable ? "" : "These work while you drive."),
  yes: (name) => `Yes: ${name}`,
  no: "No",
  sentWords: (name) => `${name}: sent to the robot.`,
  doneWords: (name, answer) => (answer ? `${name}: done. The robot says: ${answer}` : `${name}: done.`),
  failedWords: (name, why) => `${name}: failed. ${why || "The robot gave no reason."}`,
  unknownWords: (name, why) => `${name}: outcome unknown. ${why}`,
  pendingWords: (name) => `${name}: waiting for the robot.`,
  notConnected: "The robot is not connected.",
  unheard: (topic) => `Nothing on the robot listens to ${topic}.`,
  unseen: (topic) => `rosapi names no node that listens to ${topic}.`,
  lost: "The connection ended before the robot answered. It may have done it, or still do it.",
  slow: (seconds) => `No answer for ${seconds} s. The robot may still do it.`,
};

export const topics = {
  count: (some, all) => `${some === all ? "" : `${some} of `}${all} ${all === 1 ? "topic" : "topics"}`,
  none: "The robot has reported no topics.",
  more: (count) => `${count} more: narrow the search.`,
  untyped: "type unknown",
  close: (name) => `Close ${name}`,
  content: (name) => `Newest message of ${name}`,
  waiting: "Waiting for a message.",
  lost: "Not connected. This page reconnects by itself.",
  tooBig: "One message is larger than the server passes on, so this view has ended.",
  refused: (why) => `Not shown: ${why}`,
  unread: (hasOther) => `The newest message cannot be read.${hasOther ? " This is the one before." : ""}`,
  rate: (rate) => `${rate} messages/s`,
  rateAtLeast: (rate) => `At least ${rate}/s (this page asks for ${rate})`,
  rateSlow: (seconds) => `one message in ${seconds} s`,
  size: (size) => `${size} each`,
  measure: "Measure rate",
  measureHelp: (seconds) => `Receives every message for ${seconds} s`,
  measuring: "Measuring",
  measured: (rate, seconds) => `${rate} messages/s, measured ${seconds} s ago`,
  field: "Plot",
  noField: "Nothing",
  moreFields: "Further numbers are not listed",
  plot: (name) => `Plot of ${name} over the last minute`,
  unknownNow: "unknown",
  plotted: ({ now, min, max }) => `Now ${now}; in the last minute ${min} to ${max}.`,
  notPlotted: "No value in the last minute.",
  large:
    "Messages of this type can be several MB large. While one passes, video and control have less of the robot's uplink: " +
    "1 MB fills 5 Mbit/s for 1.6 s. So the page requests them one by one.",
  getOne: "Get one message",
};

// `people` and rates are null where nothing is known.
export const recording = {
  begin: "Record",
  stop: "Stop recording",
  unknown: "Whether this robot is recorded is not known.",
  bySettings: "The robot is recorded by its settings.",
  begins: "The recording is about to begin.",
  ends: "The recording ends.",
  since: (at, by) => `Recorded since ${at}${by ? `, asked for by ${by}` : ""}.`,
  notBegun: (detail) => notDone("Not recorded.", detail),
  notStopped: (detail) => notDone("Not stopped.", detail),
};

function readersText(people, yours) {
  if (people === 0) return "";
  if (yours) return people === 1 ? "you" : `you and ${people - 1} more`;
  return people === 1 ? "1 person" : `${people} people`;
}

export const uplink = {
  kinds: { camera: "Camera", topic: "Topic", video: "Snapshots and other video", rosbridge: "Services and the rest of rosbridge" },
  measuring: "Measuring",
  unknown: "? B/s",
  rate: (size) => `${size}/s`,
  total: (rate) => `In all ${rate}.`,
  full: (rate) => `The robot's line is full: it carries about ${rate} of video and topics.`,
  failed: (detail) => `Not measured now. ${detail ? sentence(detail) : "The server does not answer."}`,
  people: ({ people, yours, recorded }) => {
    if (people === null) return "";
    const readers = [readersText(people, yours), recorded && "the recording"].filter(Boolean);
    const only = readers.length === 1 && (recorded || (yours && people === 1)) ? "only " : "";
    return only + readers.join(" and ") || "nobody now";
  },
  off: "off on this page",
  offers: { off: "Switch off here", on: "Switch on" },
  offer: (offers, name) => `${uplink.offers[offers]}: ${name}`,
};

export const summary = {
  asking: "Drive ended. Summary follows.",
  missing: "Drive ended. The server has no record of it yet. It will be in the list of drives.",
  failed: "Drive ended. The server cannot show its record now. It will be in the list of drives.",
  headline: (duration, distance) => `Your drive: ${duration}, ${distance}`,
  labels: {
    duration: "Duration",
    ended: "Ended",
    distance: "Distance",
    speed: "Top speed",
    latency: "Latency",
    seen: "Seen",
    slowed: "Slowed",
    pictures: "Video",
    bytes: "Data",
    stops: "Stops",
    refused: "Blocked",
  },
  latency: (p50, p95) => `${p50} ms; 95 % within ${p95} ms`,
  seen: (p50, p95) => `${p50} ms ago; 95 % within ${p95} ms`,
  slowed: (time) => `${time}, as you saw late`,
  seenUnknown: (count) => `unknown for ${count} commands`,
  frames: (rate, size) => `${rate} a second, ${size}`,
  noVideo: "No video",
  unknown: "Not measured",
  nothing: "None",
  commanded: (text) => `${text} commanded`,
  refusals: (count, why) => `${count} ${why}`,
  droppedOld: "too old at the server",
};

// By `end_code` of a drive's record, what the person who drove reads in place of the server's words.
export const endReasons = {
  client_left: "you left this page",
  control_given_up: "you gave up control",
  client_vanished: "this page's connection lost",
  client_silent: "this page's connection went silent",
  client_slow: "this page's connection too slow",
  client_floods: "this page's connection sent too much",
};
