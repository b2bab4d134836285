// Asks the robot which topics it has, through rosapi, again and again: which of them are cameras, and which ones map and readouts
// are made of. Of robots on one graph one may start later, and show that what was seen first is not this robot's.

import { DriveTypeQuery, ask } from "../client/driveType.js";
import { plainType, speedReader } from "../client/rosbridge.js";
import { chooseTopic, ownTopics } from "./ownTopics.js";

const AGAIN_MS = 5000; // until all is known that the page needs
const CHECK_MS = 30_000;
const MAX_GONE = 1000; // topics

export class Discovery {
  // `onFound` gets {twistType, speed, cameras, topics, own, others, answered}: all topics as {name, type}, those of this robot, and
  // the names of those that are another's. Of both also those that were there on this link and are `gone`: a driver that restarts or
  // a silent rosapi says nothing of whose a topic is. Unless `answered`, which topics it has is unknown: an empty list then says nothing.
  // `driveType` and `odometryTopic` are the settings', or null.
  constructor({ driveTopic, driveType = null, odometryTopic = null, onFound }) {
    this.driveTopic = driveTopic;
    this.driveType = new DriveTypeQuery({ topic: driveTopic, set: driveType });
    this.odometryTopic = odometryTopic;
    this.onFound = onFound;
    this.round = 0;
    this.answered = false;
    this.graph = [];
  }

  // `call(service, request)` as of connection.js, another one on each link: what was answered on the last may be true no more.
  // Resolves when the robot has answered, or will not.
  async run(call) {
    if (call !== this.call) Object.assign(this, { answered: false, graph: [] });
    this.stop();
    this.call = call;
    const round = this.round;
    const [topics, twistType] = await Promise.all([allTopics(call), this.driveType.find(call)]);
    if (round !== this.round) return;
    this.graph = [...goneOf(this.graph, topics), ...topics];
    const own = ownTopics(this.graph, this.driveTopic);
    const others = this.graph.filter((topic) => !own.includes(topic)).map(({ name }) => name);
    this.answered ||= topics.some(({ type }) => type);
    const robot = { twistType, speed: this.speed(own), cameras: cameraTopics(own), topics, own, others, answered: this.answered };
    this.onFound(robot);
    const complete = robot.speed && robot.cameras.length > 0 && this.driveType.reported;
    this.timer = setTimeout(() => this.run(call), complete ? CHECK_MS : AGAIN_MS);
  }

  // For somebody who wants to know now; without effect while there is no link.
  refresh() {
    if (this.call) this.run(this.call);
  }

  stop() {
    this.call = null;
    clearTimeout(this.timer);
    this.round += 1;
  }

  // Where there is no odometry, a turtle's pose.
  speed(topics) {
    const { driveTopic, odometryTopic: named } = this;
    const { topic, candidates } = chooseTopic("odometry", topics, { named, driveTopic });
    if (topic || candidates.length) return topic && speedReader(topic.type) ? topic : undefined;
    return chooseTopic("turtle", topics, { driveTopic }).topic;
  }
}

// Whatever a robot answers: what is no name is left out, and a type that is none is not known. Without its master rosapi
// answers with no topics or no types, where each ROS has some.
async function allTopics(call) {
  const { topics, types } = await ask(call, "/rosapi/topics", {});
  const named = Array.isArray(topics) ? topics.map((name, i) => ({ name, type: textOf(types?.[i]) })) : [];
  // One that is named twice is one topic, and no two in doubt.
  const byName = new Map(named.map((topic) => [topic.name, topic]));
  return [...byName.values()].filter(({ name }) => textOf(name));
}

// The topics of before that are there no more, the last ones.
function goneOf(before, topics) {
  const names = new Set(topics.map(({ name }) => name));
  const gone = before.filter(({ name }) => !names.has(name)).slice(-MAX_GONE);
  return gone.map((topic) => ({ ...topic, gone: true }));
}

const textOf = (value) => (typeof value === "string" ? value : "");

// What the drive page can show, from the robot's settings or else from its topics. Pure.
const USUAL_CAMERA = "/camera/image_raw";
const COMPRESSED = /(.)\/compressed$/;
// What image_transport publishes as CompressedImage and no browser shows.
const NOT_SHOWN = /\/(?:compressedDepth|zstd)$/;
// Video that the robot encodes by itself.
const VIDEO_TYPES = ["foxglove_msgs/CompressedVideo", "ffmpeg_image_transport_msgs/FFMPEGPacket"];

// The names of the robot's own `topics` that are cameras, as camera_topics in robotether_common/ros.py. What lies under
// a raw image is that image by another transport.
export function cameraTopics(topics) {
  const named = (...plain) => topics.filter(({ type }) => plain.includes(plainType(type))).map(({ name }) => name);
  const raw = new Set(named("sensor_msgs/Image"));
  const encoded = [...named("sensor_msgs/CompressedImage").filter((name) => !NOT_SHOWN.test(name)), ...named(...VIDEO_TYPES)];
  const alone = encoded.filter((name) => !raw.has(parentOf(name)));
  return [...new Set([...raw, ...alone.map((name) => name.replace(COMPRESSED, "$1"))])];
}

const parentOf = (name) => name.slice(0, name.lastIndexOf("/"));

/** @typedef {{topic: string, name: string, turned_deg: number}} Camera */

// The cameras to offer: the configured ones, else the `known` topics, the usual one first and the others by name. While none
// is known it is `guess`, the one that the person saw last, or else the usual one.
/** @type {(cameras: {configured?: Camera[], known?: string[], guess?: string | null}) => Camera[]} */
export function offeredCameras({ configured = [], known = [], guess = null }) {
  if (configured.length) return configured;
  const topics = known.length ? [...known].sort(compareCameras) : [guess ?? USUAL_CAMERA];
  return topics.map((topic) => ({ topic, name: nameOf(topic, topics), turned_deg: 0 }));
}

// The usual one first, the others by name and not by the reader's language: the agent has the same order.
export const compareCameras = (a, b) => Number(a !== USUAL_CAMERA) - Number(b !== USUAL_CAMERA) || (a < b ? -1 : 1);

// What distinguishes a camera from others, without what all of them end in: "front" of /front/image_raw.
function nameOf(topic, topics) {
  const name = shortened(topic);
  return topics.some((other) => other !== topic && shortened(other) === name) ? topic : name;
}

const shortened = (topic) => topic.replace(/\/image(?:_[a-z]+)*$/, "").replace(/^\//, "") || topic;
