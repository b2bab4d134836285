// The map of a recording: gives the messages that are due to what draws the map of the drive page, at the recording's time.

import { poseReader, speedReader } from "../client/rosbridge.js";
import { MapTile } from "../overlays/mapTile.js";
import { World } from "../overlays/world.js";
import { chooseTopic, ownTopics } from "../topics/ownTopics.js";

// Zoom of a map that has a third of the page.
const MEMORY = { zoom: 1 };
const KINDS = ["scan", "map", "located", "tf", "tfStatic"];

// What of a recording is drawn, by kind, each {name, type} or undefined. The recorder may have taken other robots' topics, too. Pure.
// `named`: the topics that the settings name, by kind.
/** @returns {Record<string, {name: string, type: string} | undefined>} */
export function drawnTopics(topics, driveTopic, named = {}) {
  const own = ownTopics(topics, driveTopic);
  const isRecorded = (name) => topics.some((topic) => topic.name === name);
  const chosen = (kind) => chooseTopic(kind, own, { named: isRecorded(named[kind]) ? named[kind] : null, driveTopic }).topic;
  return { speed: chosen("odometry") ?? chosen("turtle"), ...Object.fromEntries(KINDS.map((kind) => [kind, chosen(kind)])) };
}

export class MapOfDrive {
  // `topics` [{name, type}] of the recording; `driveTopic` says which of several are the robot's own, unless `named` does.
  constructor(element, { topics, driveTopic, named, onMeasured }) {
    this.topics = drawnTopics(topics, driveTopic, named);
    this.speed = this.topics.speed;
    this.onMeasured = onMeasured;
    this.clockMs = 0;
    this.handlers = new Map();
    this.world = this.newWorld();
    this.tile = new MapTile(element, { world: this.world, memory: () => MEMORY });
    this.tile.start();
    element.hidden = !this.names.length;
  }

  // As of Topics in player.js, without frames.
  get wanted() {
    const { map, located, tf, tfStatic, scan } = this.topics;
    const names = (...topics) => topics.flatMap((topic) => (topic ? [topic.name] : []));
    return { recent: names(this.speed, located, tf, scan), newest: names(map), fixed: names(tfStatic) };
  }

  get names() {
    return Object.values(this.wanted).flat();
  }

  // Each message has a part alone.
  isMadeOfMany(topic) {
    return [this.topics.tf?.name, this.topics.tfStatic?.name].includes(topic);
  }

  newWorld() {
    const handlers = new Map();
    const subscribe = ({ name }, handler) => {
      handlers.set(name, handler);
      return () => handlers.delete(name);
    };
    this.handlers = handlers;
    const world = new World({ subscribe, onChange: () => this.tile?.draw(), now: () => this.clockMs });
    world.follow(this.topics);
    return world;
  }

  // Nothing is known of where the robot was before.
  reset() {
    this.world.map?.bitmap.close?.();
    this.world = this.tile.world = this.newWorld();
    this.world.show(this.tile.parts);
  }

  // `message` as it was decoded.
  receive(topic, message, atMs) {
    this.clockMs = atMs;
    this.handlers.get(topic)?.(message);
    const { speed } = this;
    if (speed && speed.name === topic) this.receiveOdometry(speed.type, message, atMs);
  }

  receiveOdometry(type, message, atMs) {
    this.onMeasured(speedReader(type)?.(message) ?? null, atMs);
    this.world.receivePose(poseReader(type)?.(message) ?? null);
  }

  show(atMs) {
    this.clockMs = atMs;
    this.tile.showState();
  }
}
