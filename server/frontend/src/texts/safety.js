// Sentences of the pages: how old things are and why driving is held. No logic beyond filling in.

// By the names of statusSelector.js; those of a connection that does not stand are in texts/common.js.
export const states = {
  disabled: { title: "Disabled", detail: () => "By an administrator." },
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
    detail: () => "No command reaches the wheels. Restart the agent on the robot if this stays.",
  },
  held: {
    title: "Paused",
    detail: ({ video }) => (video === "old" ? "The video is frozen." : "There is no video to drive by."),
    action: "Drive without picture",
  },
  blind: {
    title: "Driving without picture",
    detail: () => "You cannot see what is in front of the robot.",
  },
};

function afterStop(mayDrive, again) {
  if (!mayDrive) return "Somebody who may drive has to release it.";
  return again ? "Hold the button below to drive again." : "Hold the button below to release it.";
}

export const dataAge = {
  none: "-",
  exact: (ms) => String(ms),
  measured: (ms) => `speed ${ms} ms`,
  long: (seconds) => `speed ${seconds} s`,
};

export const latency = {
  parts: ({ server, robot, rosbridge }) => `${server}+${robot}+${rosbridge}`,
  words: ({ server, robot, rosbridge }) =>
    `${server} ms to the server, ${robot} ms on to the robot, ${rosbridge} ms in its rosbridge`,
  unknown: "?",
};

// Not counting this page.
export const watchers = (count) => (count > 0 ? `${count} watching.` : "");
