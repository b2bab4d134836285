// Asks the robot which topics it has, through rosapi, and asks again until it knows what the page needs: which of them
// are cameras, and which ones map and readouts are made of.

import { DriveTypeQuery, ask } from "../client/driveType.js";
import { plainType, speedReader } from "../client/rosbridge.js";
import { chooseTopic, ownTopics } from "./ownTopics.js";

const AGAIN_MS = 5000;

export class Discovery {
  // `onFound` gets {twistType, speed, cameras, topics, own}: all topics as {name, type}, and those of this robot.
  // `driveType` and `odometryTopic` are the settings', or null.
  constructor({ driveTopic, driveType = null, odometryTopic = null, onFound }) {
    this.driveTopic = driveTopic;
    this.driveType = new DriveTypeQuery({ topic: driveTopic, set: driveType });
    this.odometryTopic = odometryTopic;
    this.onFound = onFound;
    this.round = 0;
  }

  // `call(service, request)` as of connection.js. Resolves when the robot has answered.
  async run(call) {
    this.stop();
    this.call = call;
    const round = this.round;
    const [topics, twistType] = await Promise.all([allTopics(call), this.driveType.find(call)]);
    if (round !== this.round) return;
    const own = ownTopics(topics, this.driveTopic);
    const found = { twistType, speed: this.speed(own), cameras: cameraTopics(own), topics, own };
    this.onFound(found);
    if (!found.speed || found.cameras.length === 0 || !this.driveType.reported) {
      this.timer = setTimeout(() => this.run(call), AGAIN_MS);
    }
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

async function allTopics(call) {
  const { topics = [], types = [] } = await ask(call, "/rosapi/topics", {});
  return topics.map((name, i) => ({ name, type: types[i] || "" }));
}

// What the drive page can show, from the robot's settings or else from its topics. Pure.
const USUAL_CAMERA = "/camera/image_raw";
const COMPRESSED = "/compressed";

// The names of the topics that are cameras; a compressed twin is no camera of its own.
export const cameraTopics = (topics) => [...new Set(topics.flatMap(cameraName))];

function cameraName({ name, type }) {
  const plain = plainType(type);
  if (plain === "sensor_msgs/Image") return [name];
  if (plain !== "sensor_msgs/CompressedImage" || name.endsWith("/compressedDepth")) return [];
  return [name.endsWith(COMPRESSED) ? name.slice(0, -COMPRESSED.length) : name];
}

/** @typedef {{topic: string, name: string, turned_deg: number}} Camera */

// The cameras to offer: the configured ones, else the `known` topics, the usual one first and the others by name. While none
// is known it is `guess`, the one that the person saw last, or else the usual one.
/** @type {(cameras: {configured?: Camera[], known?: string[], guess?: string | null}) => Camera[]} */
export function offeredCameras({ configured = [], known = [], guess = null }) {
  if (configured.length) return configured;
  const first = (topic) => Number(topic !== USUAL_CAMERA);
  const topics = known.length ? [...known].sort((a, b) => first(a) - first(b) || a.localeCompare(b)) : [guess ?? USUAL_CAMERA];
  return topics.map((topic) => ({ topic, name: nameOf(topic, topics), turned_deg: 0 }));
}

// What distinguishes a camera from others, without what all of them end in: "front" of /front/image_raw.
function nameOf(topic, topics) {
  const name = shortened(topic);
  return topics.some((other) => other !== topic && shortened(other) === name) ? topic : name;
}

const shortened = (topic) => topic.replace(/\/image(?:_[a-z]+)*$/, "").replace(/^\//, "") || topic;
