// Sentences of the pages: how old things are and why driving is held. No logic beyond filling in.

// By the names of truth/outlook.js; those of a connection that does not stand are in texts.js.
export const states = {
  stopping: {
    title: "Stopping",
    detail: ({ stopped }) => `${stopped.by} pressed Stop at ${stopped.at}; the robot has not confirmed it yet.`,
  },
  stopped: {
    title: "Stopped",
    detail: ({ stopped, mayDrive }) =>
      `By ${stopped.by} at ${stopped.at}. ${mayDrive ? "Hold the release button below to drive again." : "Somebody who may drive has to release it."}`,
  },
  guard_down: {
    title: "Guard not answering",
    detail: () => "The robot takes no commands until its guard is back. Restart the agent there if this stays.",
  },
  held: {
    title: "Driving held",
    detail: ({ sight }) =>
      sight === "old"
        ? "The picture is too old to drive by. Goes on when a new one is here."
        : "There is no picture to drive by. Goes on when one is here.",
    action: "Drive without picture",
  },
  blind: {
    title: "Driving without picture",
    detail: () => "You do not see what is in front of the robot. Held again once a picture was back.",
  },
};

export const ages = {
  none: "-",
  exact: (ms) => String(ms),
  measured: (ms) => `${ms} ms ago`,
  long: (seconds) => `${seconds} s ago`,
};

export const trip = {
  parts: ({ server, robot, rosbridge }) => `${server} + ${robot} + ${rosbridge}`,
  words: ({ server, robot, rosbridge }) =>
    `${server} ms to the server, ${robot} ms on to the robot, ${rosbridge} ms in its rosbridge`,
  unknown: "?",
};

export const watchers = (count) => (count === 1 ? "1 other watches." : `${count} others watch.`);
