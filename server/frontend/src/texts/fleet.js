// Sentences of the pages: the fleet page. No logic beyond filling in.

export const fleet = {
  online: (since) => (since ? `Online since ${since}` : "Online"),
  offline: (since) => (since ? `Offline since ${since}` : "Never seen"),
  offlineUnknown: "It is not known why.",
  pending: "Awaiting approval",
  disabled: "Disabled",
  rtt: (ms) => `${ms} ms`,
  battery: (percent) => (percent === null ? "?" : `${Math.round(percent)} %`),
  charging: (text) => `${text}, charging`,
  low: (text) => `${text}, low`,
  ros: "rosbridge does not answer",
  video: "video does not answer",
  guard: "its guard does not answer",
  batteryLow: "battery low",
  drives: (who) => `Driver: ${who}`,
  watching: (count) => `${count} watching`,
  reservedFor: (user) => `none; reserved for ${user}`,
  driverAsked: (driver, asking) => `${driver}; ${asking} asks for control`,
  // `others`: whether there are some that this user does not manage.
  stopAll: (others) => (others ? "Stop all robots that you manage" : "Stop all robots"),
  stopSite: (site, others) => (others ? `Stop those that you manage at site ${site}` : `Stop site ${site}`),
  stopOthers: (count) =>
    count === 1
      ? "1 other robot was left out: you do not manage it. Use its own Stop."
      : `${count} other robots were left out: you do not manage them. Use the Stop of each.`,
  stopResult: ({ name, stopped, confirmed }) => {
    if (!stopped) return `${name}: not stopped`;
    return confirmed ? `${name}: stopped` : `${name}: stopping, not confirmed by the robot yet`;
  },
  stopUnreached: (machine) =>
    `This machine does not reach ${machine}: robots there get the stop once it does. Stop them on the page of ${machine}.`,
  stoppingAll: "Stopping.",
  count: (online, all) => `${online} of ${all} online`,
  shown: (count, listed) => `${count}, ${listed} shown`,
  more: (next, left) => `Show ${next} more of ${left}`,
  // `unseen`: those on other pages, or that a search hides.
  ticked: (count, one, unseen) => `${count} ${one}${count === 1 ? "" : "s"} ticked${unseen ? `, ${unseen} not shown here` : ""}`,
  tickedMost: (most, one) => `At most ${most} ${one}s at once`,
  allSites: "All sites",
  noSite: "No site",
};

const ms = (value) => `${Math.max(1, Math.round(value))} ms`;

export const nearest = {
  measuring: "Measuring which machine is nearest to you.",
  unknown: "It is not known which machine is nearest to you.",
  here: (hereMs) => `No machine that answers is clearly nearer to you than this one (${ms(hereMs)}).`,
  nearer: (name, thereMs, hereMs) => `Machine ${name} is nearer to you: ${ms(thereMs)}, this one ${ms(hereMs)}.`,
  open: (name) => `Open ${name}`,
};

export const thumb = {
  empty: "",
  taken: (robot, time) => `Picture of ${robot}, taken at ${time}`,
  waiting: "Loading",
  offline: "Robot is offline",
  video_down: "No video",
  failed: "No picture",
};
