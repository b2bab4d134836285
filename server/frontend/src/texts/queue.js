// Sentences of the pages: requests for help, the operator's queue, the supervisor's page, the wall. No logic beyond filling in.

import { notDone, sentence } from "./common.js";

const UNKNOWN = "-";

export const requests = {
  unknown: UNKNOWN,
  priorities: { 1: "Urgent", 2: "Normal", 3: "Low" },
  sources: {
    stop: "The robot was stopped",
    battery: "Battery low",
    diagnostics: "Diagnostics error",
    geofence: "Outside its area",
    navigation: "Navigation silent",
  },
  noReason: "No reason given",
  anyPool: "Any",
  states: {
    waiting: () => "Waiting",
    offered: ({ offered_to: name }) => `Offered to ${name ?? UNKNOWN}`,
    accepted: ({ accepted_by: name }) => `${name ?? UNKNOWN} works on it`,
    closed: () => "Closed",
    cancelled: () => "Cancelled",
  },
};

// By what is known of the server, as of queue/poller.js.
export const data = {
  connecting: () => "Connecting",
  live: () => "Live",
  lost: ({ since, detail }) => {
    const why = detail ? sentence(detail) : "No answer from the server.";
    return since ? `${why} What is shown is from ${since}.` : why;
  },
  login: () => "Your login has ended. Reload to log in.",
};

export const queue = {
  unknown: UNKNOWN,
  states: {
    available: ({ ahead }) => `You are available.${nextWords(ahead)}`,
    busy: ({ robot }) => (robot ? `You are busy with ${robot}.` : "You are busy."),
    wrap_up: () => "Wrap-up: you get no offers yet.",
    away: () => "You are away. Press Available to get requests.",
  },
  stateUnknown: "It is not known whether you are available.",
  lapses: {
    other: () => "You were set to away in another window.",
    silent: ({ from, to }) => `The server got no word from this page from ${from} to ${to}, so you are away.`,
    unanswered: () => "You did not answer an offer, so you are away. Press Available when you are back.",
  },
  wrapUpLeft: (seconds) => `${seconds} s left`,
  noOffers: {
    available: "Nothing is offered to you now.",
    busy: "While you are busy, nothing is offered to you.",
    wrap_up: "Nothing is offered to you before the wrap-up ends.",
    away: "While you are away, nothing is offered to you.",
  },
  offered: (robot, reason) => `${robot} asks for help: ${sentence(reason)} Accept or decline.`,
  offerLeft: (seconds) => `${seconds} s left`,
  passed: (robot) => `The offer of ${robot} is over.`,
  declined: (robot) => `You declined ${robot}.`,
  accepting: (robot) => `Opening ${robot}.`,
  closed: (robot) => `The request of ${robot} is closed.`,
  refused: (detail) => (detail ? sentence(detail) : "The server does not answer. Try again."),
  titleOffer: (robot) => `Offer: ${robot}`,
  silentSound: "The browser plays sound only after a click or a key on this page.",
  waitingNone: "No requests are waiting.",
  more: (count) => `${count} more`,
};

function nextWords(ahead) {
  if (ahead === null || ahead === undefined) return "";
  if (ahead === 0) return " You are next.";
  return ahead === 1 ? " 1 operator is before you." : ` ${ahead} operators are before you.`;
}

export const supervise = {
  operatorStates: { available: "Available", busy: "Busy", wrap_up: "Wrap-up", away: "Away" },
  worksOn: (robot, reason) => `${robot}: ${reason}`,
  none: "No request is open.",
  noOperator: "Nobody who may drive your robots has opened the queue yet.",
  option: (name, state) => `${name} (${state})`,
  choose: "Operator",
  operatorFor: (robot) => `Operator for ${robot}`,
  assign: (robot) => `Assign ${robot}`,
  chooseFirst: (robot) => `Choose an operator for ${robot} first.`,
  assigned: (robot, name) => `${robot} is offered to ${name}.`,
  close: (robot) => `Close the request of ${robot}`,
  closed: (robot) => `The request of ${robot} is closed.`,
  notClosed: (robot, detail) => notDone(`${robot}: not closed.`, detail),
  charts: { requests: "Requests", waits: "Wait until accepted" },
  lines: {
    made: (all, most) => `Asked: ${all} in all, at most ${most}`,
    closed: (all, most) => `Done: ${all} in all, at most ${most}`,
    cancelled: (all, most) => `Cancelled: ${all} in all, at most ${most}`,
    waiting_p50_s: (most) => `Half within: at most ${most}`,
    waiting_p95_s: (most) => `95 % within: at most ${most}`,
  },
  noWaits: "No wait is known in this time.",
  partly: (count) => `; unknown for the first ${count}`,
  periods: { hour: "The last 24 hours, by hour.", day: "The last 30 days, by day of UTC." },
  noPeriods: (detail) => (detail ? sentence(detail) : "The server does not answer."),
  failed: (robot, detail) => notDone(`${robot}: not assigned.`, detail),
};

export const wall = {
  asks: (reason, duration) => `Asks for help (${duration}): ${reason}`,
  urgent: (words) => `Urgent. ${words}`,
  accepted: (words, name) => `${words}, ${name} works on it`,
  asking: (names) => {
    if (names.length === 0) return "";
    return names.length === 1 ? `${names[0]} asks for help.` : `${names.length} robots ask for help: ${names.join(", ")}.`;
  },
  // `fitting`: of `all` those that a search or filter leaves.
  count: (shown, fitting, all, most) => {
    if (shown < fitting && fitting < all) return `${shown} of the ${fitting} robots found, ${most} at most; search for less to see others`;
    if (shown < fitting) return `${shown} of ${all} robots, ${most} at most; search to see others`;
    return shown === all ? `${all} ${all === 1 ? "robot" : "robots"}` : `${shown} of ${all} robots`;
  },
  stopped: (name) => `Stopped by ${name}`,
  drive: "Drive",
  watch: "Watch",
};

export const help = {
  open: "Help requested",
  unknown: "It is not known whether help was requested.",
  sent: "The request waits for an operator.",
  already: (reason) => `Help was already requested: ${sentence(reason)}`,
  failed: (detail) => notDone("Not requested.", detail),
  ends: {
    cancel: { words: "Withdraw", done: "The request is withdrawn.", failed: (detail) => notDone("Not withdrawn.", detail) },
    close: { words: "Close", done: "The request is closed.", failed: (detail) => notDone("Not closed.", detail) },
  },
};
