// The places of the video: makes a tile for what is shown, ends what is not, and says which is the main one.
// What is not seen has no stream.

import { DecoderChoice } from "../decoders/frameDecoder.js";
import { cloned } from "../dom/keyedRows.js";
import { part, setText } from "../dom/page.js";
import { frame as texts } from "../texts/video.js";
import { MapTile } from "../overlays/mapTile.js";
import { CameraTile } from "./cameraTile.js";
import { MAP } from "./layout.js";

export class Tiles {
  // `options`: what CameraTile and MapTile take, and `onChoose(id)` for a small tile that is to be the main one.
  constructor(stage, options) {
    this.stage = stage;
    this.options = options;
    this.tiles = new Map();
    this.choice = new DecoderChoice();
    this.off = new Set(); // cameras that the person switched off
    this.playing = false;
    this.lastSeen = [];
  }

  get(id) {
    return this.tiles.get(id);
  }

  each(act) {
    this.tiles.forEach(act);
  }

  // The frames that the driver saw at this time, {topic, sequence, at, shownAt}: one of each camera that is shown, is on and has
  // shown any, else what was seen last, as old as that gets.
  seenAt(timestamp) {
    const cameras = [...this.tiles].filter(([id]) => id !== MAP && !this.off.has(id));
    const frames = cameras.map(([topic, tile]) => ({ topic, ...tile.shownFrames.seenAt(timestamp) }));
    const seen = frames.filter(({ sequence }) => sequence !== undefined);
    if (seen.length) this.lastSeen = seen;
    return this.lastSeen;
  }

  // What was shown may be older than it says.
  forget() {
    this.lastSeen = [];
    this.each((tile) => tile.forget());
  }

  // `shown` are {topic, name}, in their order; `turned(camera)` in degrees; `playing` false ends all streams, and `why` says why.
  arrange({ kind, main, shown, turned, playing, why }) {
    this.playing = playing;
    this.stage.dataset.layout = shown.length > 1 ? kind : "one";
    this.stage.dataset.tiles = shown.length;
    const ids = shown.map(({ topic }) => topic);
    for (const [id, tile] of this.tiles) if (!ids.includes(id)) this.drop(id, tile);
    shown.forEach((source, place) => this.place(source, place, main));
    for (const source of shown) {
      const tile = this.tiles.get(source.topic);
      tile.turn(turned(source));
      if (this.off.has(source.topic)) tile.stop("off");
      else if (playing) tile.start();
      else tile.stop(why);
    }
    this.each((tile) => tile.ask());
  }

  // Whether a camera has a place here; with switchTo as of topics/uplink.js. Without the main one driving pauses.
  has(id) {
    return id !== MAP && this.tiles.has(id);
  }

  switchTo(id, on) {
    if (on) this.off.delete(id);
    else this.off.add(id);
    if (!on) this.get(id)?.stop("off");
    else if (this.playing) this.get(id)?.start();
  }

  // How the frames of a camera are encoded.
  note(id) {
    return this.get(id)?.encoding ?? "";
  }

  drop(id, tile) {
    tile.close();
    this.tiles.delete(id);
  }

  place(source, place, main) {
    const { topic: id, name } = source;
    if (!this.tiles.has(id)) this.tiles.set(id, this.make(source));
    const { element } = this.tiles.get(id);
    const isMain = id === main;
    element.dataset.place = place;
    element.dataset.main = isMain;
    // The main tile has this test id wherever it is.
    part(element, "canvas").dataset.testid = isMain ? "video" : "side-video";
    const button = part(element, "enlarge");
    button.hidden = isMain;
    button.setAttribute("aria-label", texts.enlarge(name));
    setText(part(element, "name"), name);
  }

  make(source) {
    const isMap = source.topic === MAP;
    const template = part(this.stage, isMap ? "map-tile" : "camera-tile");
    const element = cloned(template);
    this.stage.append(element);
    part(element, "enlarge").addEventListener("click", () => this.options.onChoose(source.topic));
    return isMap ? new MapTile(element, this.options) : new CameraTile(element, { ...this.options, choice: this.choice, camera: source });
  }
}
