// Which topics of a ROS graph, which several robots may share, are this robot's. The drive topic's namespace decides. Pure.
// Agent and recorder have the same rule (robotether_common/own_topics.py); test/topics/ros_graphs.json holds all to it.

import { isDriveType, plainType } from "../client/rosbridge.js";

// Of each kind: the types, the best first, and the usual names in the robot's namespace.
const KINDS = {
  odometry: { types: ["nav_msgs/Odometry"], usual: ["odom"] },
  turtle: { types: ["turtlesim/Pose"], usual: ["pose"] },
  scan: { types: ["sensor_msgs/LaserScan"], usual: ["scan"] },
  map: { types: ["nav_msgs/OccupancyGrid"], usual: ["map"] },
  located: { types: ["geometry_msgs/PoseWithCovarianceStamped"], usual: ["amcl_pose", "pose"] },
  // The aggregator's topic has all in one message, each of the other's only a part.
  diagnostics: { types: ["diagnostic_msgs/DiagnosticArray"], usual: ["diagnostics_agg", "diagnostics"] },
  tf: { types: ["tf2_msgs/TFMessage", "tf/tfMessage"], usual: ["tf"], last: "tf" },
  tfStatic: { types: ["tf2_msgs/TFMessage", "tf/tfMessage"], usual: ["tf_static"], last: "tf_static" },
};

const segments = (name) => name.split("/").filter(Boolean);

// The topics without those of other robots. Another robot is a branch that has a drive topic of its own and lies beside the
// namespace of this robot's, or in it where that is the root, which is everybody's.
export function ownTopics(topics, driveTopic) {
  const home = new Home(driveTopic);
  const others = new Set(topics.filter((topic) => home.drivesAnother(topic)).map(({ name }) => home.branch(name)));
  return topics.filter(({ name }) => !others.has(home.branch(name)));
}

// {topic, candidates}: the topic {name, type} of a kind, as the settings name it or the best of `topics`, which are the robot's
// own (`gone` as of discovery.js); undefined for none. Of several that are equally good none is, and `candidates` are their names.
/** @type {(kind: string, topics: {name: string, type: string}[], options?: {named?: string | null, driveTopic?: string}) => {topic: {name: string, type: string} | undefined, candidates: string[]}} */
export function chooseTopic(kind, topics, { named = null, driveTopic = "" } = {}) {
  const { types, last } = KINDS[kind];
  if (named) return { topic: topics.find(({ name }) => name === named) ?? { name: named, type: types[0] }, candidates: [] };
  const home = new Home(driveTopic);
  const fit = topics.filter(({ name, type }) => types.includes(plainType(type)) && (!last || segments(name).at(-1) === last));
  const ranked = fit.map((topic) => ({ topic, rank: home.rank(topic, KINDS[kind].usual) })).sort((a, b) => compare(a.rank, b.rank));
  const best = ranked.filter(({ rank }) => compare(rank, ranked[0].rank) === 0).map(({ topic }) => topic);
  if (best.length > 1) return { topic: undefined, candidates: best.map(({ name }) => name).sort() };
  return { topic: best[0], candidates: [] };
}

/** @typedef {{name: string, type: string}} Topic */

// What is chosen of each kind as the robot's graph changes.
export class TopicChoice {
  // `named` gives the topic of a kind that the settings name, or nothing.
  constructor({ named, driveTopic }) {
    this.named = named;
    this.driveTopic = driveTopic;
    this.last = /** @type {Record<string, Topic | undefined>} */ ({});
  }

  // {chosen, inDoubt, left}: the topics by kind, {kind, candidates} of what is in doubt, and the kinds whose last topic is another
  // robot's or gave way to another one, so that what it said is no fact of this robot. `others` as of discovery.js.
  choose(topics, others) {
    const chosen = /** @type {Record<string, Topic | undefined>} */ ({});
    const inDoubt = /** @type {{kind: string, candidates: string[]}[]} */ ([]);
    const left = /** @type {string[]} */ ([]);
    for (const kind of Object.keys(KINDS)) {
      const { topic, candidates } = chooseTopic(kind, topics, { named: this.named(kind), driveTopic: this.driveTopic });
      if (candidates.length) inDoubt.push({ kind, candidates });
      if (isLeft(this.last[kind], topic, others)) left.push(kind);
      chosen[kind] = topic;
      this.last[kind] = topic ?? (left.includes(kind) ? undefined : this.last[kind]);
    }
    return { chosen, inDoubt, left };
  }
}

const isLeft = (last, now, others) => Boolean(last && last.name !== now?.name && (now || others.includes(last.name)));

// The namespace of the robot's drive topic, as the place that others are near to or far from.
class Home {
  constructor(driveTopic) {
    const path = segments(driveTopic);
    this.path = path.slice(0, -1);
    this.last = path.at(-1);
  }

  // How many segments of the namespace a topic's own has in common with it.
  shared(path) {
    const apart = this.path.findIndex((segment, i) => segment !== path[i]);
    return apart < 0 ? this.path.length : apart;
  }

  // The namespace in which a topic leaves this robot's; null for one in it, or beside the way to it.
  branch(name) {
    const path = segments(name).slice(0, -1);
    const shared = this.shared(path);
    const leaves = path.length > shared && (shared < this.path.length || this.path.length === 0);
    return this.last && leaves ? path.slice(0, shared + 1).join("/") : null;
  }

  // Its type may be unknown, as of a topic that nobody publishes.
  drivesAnother({ name, type }) {
    return this.branch(name) !== null && (isDriveType(type) || segments(name).at(-1) === this.last);
  }

  // The nearest namespace first, then what is there, then the usual names, then those that lie less deep.
  rank({ name, gone = false }, usual) {
    const path = segments(name);
    const shared = this.shared(path.slice(0, -1));
    const within = path.slice(shared).join("/");
    return [-shared, Number(gone), usual.includes(within) ? usual.indexOf(within) : usual.length, path.length];
  }
}

const compare = (a, b) => a.map((value, i) => value - b[i]).find((difference) => difference !== 0) ?? 0;
