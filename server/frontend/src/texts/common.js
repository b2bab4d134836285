// Sentences of the pages: connection, control, stop and release. No logic beyond filling in.

// What robot and server say in the middle of a sentence of theirs; the name of a program keeps its small letter.
export const sentence = (words) =>
  `${/^[a-z]+_/.test(words) ? words : words.charAt(0).toUpperCase() + words.slice(1)}${/[.!?]$/.test(words) ? "" : "."}`;

// Why the server did not do what it was asked for, which the page's own words say.
export const because = (detail) => sentence(detail.replace(/^cannot .*?: /, ""));

// What the server was asked for and did not do, and why. It may have done what it gives no answer to.
export const notDone = (what, detail) => (detail ? `${what} ${because(detail)}` : "No answer from the server: it may have done it.");

// The reason as it was written where it is known best, then what to do.
export const explained = (reason, advice) => (reason ? `${sentence(reason)} ${advice}` : advice);

const unopened =
  "The server answers, but opens no connection to the robot. Perhaps it restarts, or a proxy in front of it passes no WebSockets;";

export const connection = {
  connecting: {
    title: "Connecting",
    detail: ({ driving }) => (driving ? "Taking control." : "Opening the connection to the robot."),
  },
  live: {
    title: "Live",
    detail: ({ driving, armed, free }) => {
      if (!driving) return free ? "You are watching. Press Drive, or a key or stick, to drive." : "You are watching.";
      return armed ? "Ready to drive." : "Press Start driving when you are ready.";
    },
  },
  offline: {
    title: "Robot offline",
    detail: ({ since, why, reason }) =>
      `${offlineSince(since, reason)}${why ? `${why} ` : ""}This page connects by itself when the robot is back.`,
    action: "Try now",
  },
  rosbridge_down: {
    title: "ROS not answering",
    detail: ({ reason }) =>
      reason
        ? explained(reason, "Start rosbridge there if it does not run; this page keeps trying.")
        : "The robot is online, but its rosbridge is not. Start rosbridge there; this page keeps trying.",
    action: "Try now",
  },
  link_lost: {
    title: "Link lost",
    detail: ({ reason, driving }) => explained(reason, `${driving ? "No command reaches the robot. " : ""}This page reconnects by itself.`),
    action: "Try now",
  },
  server_unreachable: {
    title: "Server unreachable",
    // `answered`: the server gave this page a ticket.
    detail: ({ reason, answered }) => reason || `${answered ? unopened : "Check this device's network;"} this page keeps trying.`,
    action: "Try now",
  },
  not_allowed: { title: "Not allowed", detail: ({ reason }) => reason || "Your account may not open this robot.", action: "Reload" },
  lease_unavailable: {
    title: "Control unavailable",
    detail: ({ reason }) =>
      reason ? explained(reason, "This page keeps trying.") : "The server cannot give control to anybody now; this page keeps trying.",
    action: "Try now",
  },
};

// Who drives, and why this page does or does not.
export const control = {
  drive: "Drive",
  driveHere: "Drive here",
  nobody: "Nobody is driving",
  you: "You are driving",
  yourOther: "You are driving in another window",
  other: (user, since) => `${user} is driving (since ${since})`,
  reservedForYou: "Control is reserved for you.",
  reserved: (user) => `Control is reserved for ${user}.`,
  waiting: (user) => `, ${user} asks`,
  noDriveTopic: "This robot has no drive topic, so nothing here moves it. A manager sets one in Settings, Driving, Drive topic.",
  outdated: "Your rights or this robot's settings have changed. Reload the page.",
  guardDown: "The robot's guard does not answer. The robot accepts no commands until it is back.",
  guardOff: "This robot's guard is switched off. The robot does not stop by itself.",
  guardOld: "This robot's agent is too old to drive slower when you see late. Its administrator should upgrade it.",
  asks: (user) => `${user} asks for control.`,
  passes: (user, seconds) => `If you neither reply nor drive, control passes to ${user} in ${seconds} s.`,
  arrives: (user, seconds) => `You asked ${user}. If ${user} neither replies nor drives, you get control in ${seconds} s.`,
  takeSure: (user) => `Take control from ${user}? The robot stops, and ${user} can only watch.`,
  failed: (detail) => (detail ? sentence(detail) : "The server does not answer. Try again."),
};

// By why the drive mode changed, as in driveMode.js.
export const driveMode = {
  lease_held: () => "Somebody else has control, so you are watching.",
  lease_lost: ({ reason }) => `You no longer drive: ${reason || "somebody else has control"}.`,
  handed_over: ({ by }) => `You handed control to ${by}.`,
  superseded: () => "You continued in another window, so this one is watching.",
  robot_stopped: () => "", // the strip says who stopped it
  stopped_meanwhile: () => "The robot was stopped, so nobody gets control.",
  refused: ({ by }) => `${by} refused your request.`,
  arrived: () => "You have control now.",
  pressed: () => "You took control.",
  busy_driver: ({ by }) => `${by} is driving. To drive, ask for control.`,
  busy_reserved: ({ by }) => `${by} is about to drive.`,
  busy_stopped: () => "The robot is stopped. Release it to drive.",
  busy_window: () => "You are driving in another window. Press Drive here to continue in this one.",
  released: () => "The robot is released.",
  left: () => "You gave up control.",
  failed: ({ reason }) => reason,
};

export const stop = {
  none: () => "",
  ended: "Stop does not work on this page any more.",
  asked: () => "Stopping.",
  heard: () => "Stopping: not confirmed by the robot yet.",
  // `guard` of the control object.
  unheard: (/** @type {{guard?: string}} */ { guard } = {}) => `No answer yet, trying again. ${halts(guard)}`,
  failed: () => "Stop not confirmed. Press Stop again.",
  refused: ({ detail }) => `Not stopped. ${detail ? because(detail) : "The server refused it."}`,
  stopping: ({ by, at }) => `Stopping, not confirmed yet (${by}, ${at}).`,
  stopped: ({ by, at }) => `Stopped by ${by} at ${at}`,
  unknown: ({ at }) => `Stopped at ${at}; not known now.`,
};

export const release = {
  idle: "Hold to release",
  again: "Hold to drive again",
  held: "Keep holding",
  once: "Press again to release",
  asked: "Releasing",
  failed: (detail) => (detail ? `Not released. ${because(detail)}` : "Release not confirmed. The server does not answer."),
};

export const reasons = {
  login: "Your login has ended. Log in again.",
  robot: "This robot has another name or MAC now, was removed, or you have no access to it any more: look for it among your robots.",
  grant: "Reload the page to see what you may still do.",
  changed: "Your rights have changed.",
  stale: "This page is too old.",
  reload: "Reload the page.",
  restarting: "The server is restarting; this page keeps trying.",
  trouble: "The server cannot answer now.",
  busy: "The server gets too many requests.",
  trying: "This page keeps trying.",
  between: "cannot reach the server: something in between answers in its place, such as a proxy or its log-in page",
  crowded: "Close other windows; this page keeps trying.",
  site: (origin) => `The server answers, but no request of this page: is ${origin} in its ALLOWED_ORIGINS?`,
};

export const logIn = "Log in";

function offlineSince(since, reason) {
  if (since) return `Since ${since}. `;
  return reason ? `The server says: ${reason}. ` : "";
}

export const readings = { none: "-", wanted: (value) => `asked ${value}`, old: (seconds) => `${seconds} s old` };

export const limits = { linear: (value) => `${value.toFixed(2)} m/s`, angular: (value) => `${Math.round((value * 180) / Math.PI)} °/s` };

export const feed = {
  connecting: "Connecting",
  live: "Live",
  lost: "Connection lost, states may be old. Reconnecting.",
  login: "Your login has ended. Reload to log in.",
};

// Sentences of the pages: how old things are and why driving is held. No logic beyond filling in.

// By the names of selectStatus; those of a connection that does not stand are above.
export const states = {
  disabled: { title: "Disabled", detail: () => "By an administrator." },
  gone: { title: "Robot not found", detail: ({ reason }) => reason || reasons.robot, action: "All robots" },
  renamed: { title: "Renamed", detail: ({ renamed }) => `This robot is called ${renamed} now.`, action: "Open its page" },
  stopping: {
    title: "Stopping",
    detail: ({ stopped }) => `${stopped.by} pressed Stop at ${stopped.at}; the robot has not confirmed it yet.`,
  },
  stopped: {
    title: "Stopped",
    detail: ({ stopped, mayDrive, again }) => `By ${stopped.by} at ${stopped.at}. ${afterStop(mayDrive, again)}`,
  },
  guard_down: {
    title: "Guard not answering",
    detail: () => "No command reaches the wheels. If this persists, restart the agent on the robot.",
  },
  silent: {
    title: "No connection",
    headline: ({ silentS }) => `No connection for ${silentS} s.`,
    detail: ({ control }) => halts(control?.guard),
  },
  held: {
    title: "Paused",
    detail: ({ video, hasCamera }) => {
      if (video === "old") return "The video is frozen.";
      return hasCamera ? "There is no video to drive by." : "Whether the robot has a camera is not known.";
    },
    action: "Drive without video",
  },
  slow: { title: "Connection too slow", detail: () => "Commands are too old when they reach the robot, which drops them." },
  blind: { title: "Driving without video", detail: () => "You cannot see what is in front of the robot." },
};

// What a robot does without commands; those of another driver may reach it while this page has no connection.
function halts(guard) {
  if (guard === "ready") return "Without commands the robot halts by itself.";
  return guard === "off"
    ? "Its guard is switched off: the robot does not stop by itself."
    : "Whether the robot halts by itself is not known.";
}

function afterStop(mayDrive, again) {
  if (!mayDrive) return "Somebody who may drive has to release it.";
  return again ? "Hold the button beside Stop to drive again." : "Hold the button beside Stop to release it.";
}

export const latency = {
  words: ({ server, robot, rosbridge }) => `${server} ms to the server, ${robot} ms on to the robot, ${rosbridge} ms in its rosbridge`,
  unknown: "?",
};

// How old is what the driver sees.
export const seen = {
  ago: (ms) => `seen ${ms} ms ago`,
  unknown: "?",
  slowed: (speed, turn) => `slowed to ${[speed, turn].filter(Boolean).join(", ")}`,
  why: "The robot does not know the frames that this page shows.",
  parts: (video, held, rest) => `about ${video} ms until it is shown, ${held} ms until the command, ${rest} ms on to the robot`,
};

// So that nobody is recorded without knowing. `records` is null where nobody says so.
export function recorded(records, drives) {
  if (records === null) return "Whether this robot is recorded is not known.";
  if (!records) return "";
  return drives ? "This drive is being recorded." : "This robot is being recorded.";
}

// Not counting this page.
export const watchers = (count) => (count > 0 ? `${count} watching.` : "");
