// Sentences of the page that plays a recording back. No logic beyond filling in.

import { because } from "./common.js";

const pad = (number) => String(number).padStart(2, "0");

// 0:07, 12:30, 1:02:30.
export function clockText(ms) {
  const seconds = Math.floor(Math.max(0, ms) / 1000);
  const [hours, minutes] = [Math.floor(seconds / 3600), Math.floor((seconds % 3600) / 60)];
  return hours ? `${hours}:${pad(minutes)}:${pad(seconds % 60)}` : `${minutes}:${pad(seconds % 60)}`;
}

export const replay = {
  notRecorded: "not recorded",
  ms: (value) => `${Math.round(value)} ms`,
  nobody: "Nobody",
  online: "Online",
  offline: "Offline",
  stopped: (by, confirmed) => `Stopped${by ? ` by ${by}` : ""}${confirmed ? "" : ", not confirmed"}`,
  noCommand: "No command",
  outcomes: {
    sent: "sent to the robot",
    too_old: "not sent: too old",
    ahead: "not sent: its time is ahead",
    replaced: "not sent: a newer one replaced it",
    clock_unknown: "not sent: its age is not known",
  },
  notSlowed: "not slowed",
  slowed: (words) => (words ? `slowed to ${words}` : "slowed"),
  roundTrip: (driver, robot) => `driver ${driver}, robot ${robot}`,
  drives: (name) => `${name} drives`,
  nobodyDrives: "Nobody drives",
  wasStopped: (by) => `Stopped${by ? ` by ${by}` : ""}`,
  stopConfirmed: "Stop confirmed by the robot",
  released: "Released",
  wentOnline: "Robot online",
  wentOffline: "Robot offline",
  unknownFrom: "From here on it is not recorded who drives",
  noEvents: "The recording has no change of driver and no stop.",
  unknownEvents: "Who drove is not recorded.",
  moreEvents: (count) => `The first ${count} are listed.`,
  play: "Play",
  pause: "Pause",
  at: (at, duration) => `${clockText(at)} of ${clockText(duration)}`,
  opening: "Opening the recording.",
  loading: "Loading.",
  empty: "The recording has no messages.",
  goesOn: "This recording is in progress. It plays up to the time at which this page was opened.",
  unfinished: "This recording did not end properly. It plays as far as it was written.",
  cut: "The search for its end would take too long.",
  damaged: "A part of the recording cannot be read and is left out.",
  unreadable: "Messages that do not match their type are left out.",
  otherTimes: "A part of the recording has impossible times and is left out.",
  failed: (status, detail) => {
    if (status === 401) return "Your login has ended. Log in again.";
    const usual = status ? `The server answered ${status}.` : "The server does not answer.";
    return `The recording cannot be read. ${detail ? because(detail) : usual}`;
  },
  noRecording: "The file is not a recording that this page can read.",
  noVideo: "No video is recorded.",
  gap: "No video is recorded here.",
  noKeyFrame: "The video starts at the next key frame.",
  undecodable: "This browser cannot decode the video here.",
  of: (camera) => `Recorded video of ${camera}`,
};
