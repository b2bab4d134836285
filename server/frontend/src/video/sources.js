// What the drive page can show of a robot: its cameras, from its settings or else from its topics, and the topics that the
// map and the readouts are made of. Pure.

import { plainType } from "../client/messages.js";

// No topic has this name.
export const MAP = "map:";

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

// The names of the topics that are cameras; a compressed twin is no camera of its own.
export function cameraTopics(topics) {
  return [...new Set(topics.flatMap(cameraName))].sort();
}

function cameraName({ name, type }) {
  const plain = plainType(type);
  if (plain === "sensor_msgs/Image") return [name];
  if (plain !== "sensor_msgs/CompressedImage" || name.endsWith("/compressedDepth")) return [];
  return [name.endsWith(COMPRESSED) ? name.slice(0, -COMPRESSED.length) : name];
}

// The cameras {topic, name, turned_deg} to offer: the configured ones, else the `known` topics, else the usual one.
export function offeredCameras({ configured = [], known = [] }) {
  if (configured.length) return configured;
  const topics = known.length ? known : [USUAL_CAMERA];
  return topics.map((topic) => ({ topic, name: nameOf(topic, topics), turned_deg: 0 }));
}

// What tells a camera from others, without what all of them end in: "front" of /front/image_raw.
function nameOf(topic, topics) {
  const name = shortened(topic);
  return topics.some((other) => other !== topic && shortened(other) === name) ? topic : name;
}

const shortened = (topic) => topic.replace(/\/image(?:_[a-z]+)*$/, "").replace(/^\//, "") || topic;
