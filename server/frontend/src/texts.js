// Every sentence that the scripts show, in one place, ready for translation. No logic beyond filling in.

export const level = {
  observe: "You may watch",
  drive: "You may drive",
  manage: "You may drive and manage",
};

export const connection = {
  connecting: { title: "Connecting", detail: () => "Opening the connection to the robot." },
  live: {
    title: "Live",
    detail: ({ driving, drivers }) => (driving ? "Ready to drive." : watching(drivers)),
  },
  offline: {
    title: "Robot offline",
    detail: ({ since, reason }) =>
      `${offlineSince(since, reason)}Connects by itself when it is back.`,
    action: "Try now",
  },
  rosbridge_down: {
    title: "ROS not answering",
    detail: () =>
      "The robot is online, its rosbridge is not. Start rosbridge there; this page keeps trying.",
    action: "Try now",
  },
  link_lost: {
    title: "Link lost",
    detail: () => "No command reaches the robot. Resuming by itself.",
    action: "Try now",
  },
  server_unreachable: {
    title: "Server unreachable",
    detail: ({ reason }) => reason || "Check this device's network; this page keeps trying.",
    action: "Try now",
  },
  not_allowed: {
    title: "Not allowed",
    detail: ({ reason }) => reason || "Your account may not open this robot.",
    action: "Reload",
  },
  superseded: {
    title: "Continued elsewhere",
    detail: () => "You opened this robot in another window, and that one took over.",
    action: "Continue here",
  },
};

export const reasons = {
  login: "Your login has ended. Log in again.",
  robot: "There is no such robot, or it is not open to you.",
  grant: "Your account may no longer do this. Reload to see what is left.",
  stale: "This page is too old. Reload it.",
  restarting: "The server is restarting; this page keeps trying.",
  busy: "The server asks to slow down; this page keeps trying.",
  crowded: "Too many connections to this robot or of your account are open. Close other windows; this page keeps trying.",
};

export const logIn = "Log in";

function offlineSince(since, reason) {
  if (since) return `Since ${since}. `;
  return reason ? `The server says: ${reason}. ` : "";
}

function watching(drivers) {
  if (drivers.length === 0) return "You are watching. Nobody is driving.";
  return `You are watching. ${list(drivers)} ${drivers.length === 1 ? "is" : "are"} driving.`;
}

export const picture = {
  starting: "Waiting for the first picture.",
  camera_missing: "The robot offers no camera topic.",
  robot_offline: "No picture: the robot is offline.",
  video_down: "No picture: the robot's video server does not answer.",
  login_missing: "No picture: your login has ended.",
  refused: (status) => `No picture: the server answered ${status}.`,
  cut: "No picture: the stream was cut. Starting it again.",
  paused: "Paused while this page is in the background.",
  old: (seconds) => `The picture is ${seconds} s old.`,
};

export const readings = {
  none: "-",
  wanted: (value) => `set ${value}`,
  old: (seconds) => `${seconds} s old`,
};

export const limits = {
  linear: (value) => `${value} m/s`,
  angular: (value) => `${value} rad/s`,
};

export const fleet = {
  online: (since) => (since ? `Online since ${since}` : "Online"),
  offline: (since) => (since ? `Offline since ${since}` : "Never seen"),
  pending: "Waiting for approval",
  disabled: "Disabled",
  rtt: (ms) => `${ms} ms`,
  ros: "rosbridge does not answer",
  video: "video does not answer",
  count: (online, all) => `${online} of ${all} online`,
  list,
};

export const feed = {
  connecting: "Connecting",
  live: "Live",
  lost: "Connection lost, states may be old. Reconnecting.",
  login: "Your login has ended. Reload to log in.",
};

function list(names) {
  if (names.length < 2) return names.join("");
  return `${names.slice(0, -1).join(", ")} and ${names.at(-1)}`;
}
