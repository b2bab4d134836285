// Sentences of the page of routes. No logic beyond filling in.

import { because, notDone, sentence } from "./common.js";

export const routes = {
  choose: "Drag a topic from the left to one of the same type on the right; or press the one, then the other.",
  chosen: ({ robot, topic, type }) => `From ${robot} ${topic}: now press a topic of type ${type} on the right, or Escape.`,
  made: "The route is made.",
  removed: "The route is removed.",
  notMade: (detail) => notDone("The route is not made.", detail),
  notRemoved: (detail) => notDone("The route is not removed.", detail),
  otherType: (from, to) => `${from.topic} has the type ${from.type}, and ${to.topic} ${to.type}`,
  loading: "Asking the robot.",
  noTopics: "It has no topics.",
  noTopicsHere: "It has no topics on this side.",
  app: (name, machine) => (machine ? `${name}, at machine ${machine}` : name),
  appAway: "It is connected to no machine that answers.",
  unknownTopics: (detail) => `Its topics are not known${detail ? `: ${because(detail)}` : "."}`,
  remove: ({ source, sourceTopic, target, targetTopic }) => `Remove the route from ${source} ${sourceTopic} to ${target} ${targetTopic}`,
  unknown: "Not known",
  rate: (hz) => `${hz}/s`,
  runs: (rate, why) => `Runs, ${rate}/s${why ? `. ${sentence(why)}` : ""}`,
  waits: (why) => `Waits${why ? `: ${why}` : ""}`,
  elsewhere: "Not on this machine; another one may know its state",
};
