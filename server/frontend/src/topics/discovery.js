// Asks the robot which topics it has, through rosapi, and asks again until it knows what the page needs: which of them
// are cameras, and which ones map and readouts are made of.

import { DriveTypeQuery, ask } from "../client/driveType.js";
import { plainType, speedReader, speedTopic } from "../client/rosbridge.js";

const AGAIN_MS = 5000;

export class Discovery {
  // `onFound` gets {twistType, speed, cameras, topics}, all topics as {name, type}. `driveType` and `odometryTopic` are
  // the settings', or null.
  constructor({ driveTopic, driveType = null, odometryTopic = null, onFound }) {
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
    const found = {
      twistType,
      speed: this.speed(topics),
      cameras: cameraTopics(topics),
      topics,
    };
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

  speed(topics) {
    if (!this.odometryTopic) return speedTopic(topics);
    const named = topicOf("odometry", topics, this.odometryTopic);
    return speedReader(named.type) ? named : undefined;
  }
}

async function allTopics(call) {
  const { topics = [], types = [] } = await ask(call, "/rosapi/topics", {});
  return topics.map((name, i) => ({ name, type: types[i] || "" }));
}

// What the drive page can show, from the robot's settings or else from its topics. Pure.
const USUAL_CAMERA = "/camera/image_raw";
const COMPRESSED = "/compressed";

// Of each kind: the type, and the usual names, the best first.
const KINDS = {
  odometry: { type: "nav_msgs/Odometry", usual: ["/odom"] },
  scan: { type: "sensor_msgs/LaserScan", usual: ["/scan"] },
  map: { type: "nav_msgs/OccupancyGrid", usual: ["/map"] },
  located: { type: "geometry_msgs/PoseWithCovarianceStamped", usual: ["/amcl_pose", "/pose"] },
  battery: { type: "sensor_msgs/BatteryState", usual: ["/battery_state", "/battery"] },
  // The aggregator's topic has all in one message, each of the other's only a part.
  diagnostics: { type: "diagnostic_msgs/DiagnosticArray", usual: ["/diagnostics_agg", "/diagnostics"] },
};

// The topic {name, type} of a kind: the one that the settings name, else the usual, else any of the type, else undefined.
export function topicOf(kind, topics, named = null) {
  const { type, usual } = KINDS[kind];
  if (named) return topics.find(({ name }) => name === named) ?? { name: named, type };
  const rank = ({ name }) => (usual.includes(name) ? usual.indexOf(name) : usual.length);
  const fit = topics.filter((topic) => plainType(topic.type) === type);
  return fit.sort((a, b) => rank(a) - rank(b) || a.name.localeCompare(b.name))[0];
}

const FRAME_TYPES = ["tf2_msgs/TFMessage", "tf/tfMessage"];

// The topics of the robot's frames, each {name, type} or undefined; a robot in a namespace may have them there.
export function frameTopics(topics) {
  const known = topics.filter(({ type }) => FRAME_TYPES.includes(plainType(type)));
  const named = (last) =>
    known.filter(({ name }) => name.endsWith(last)).sort((a, b) => a.name.length - b.name.length || a.name.localeCompare(b.name))[0];
  return { tf: named("/tf"), tfStatic: named("/tf_static") };
}

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
