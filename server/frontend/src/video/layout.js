// How the tiles are arranged: one, one with another inset, or a grid, and which of them is the main one. Pure.
// Sources are named by ids: topics of cameras, and MAP.

// No topic has this name.
export const MAP = "map:";

const KINDS = ["one", "inset", "grid"];

const GRID_PLACES = 4;
const QUARTER = 90;

export class Layout {
  // `memory` is what an earlier visit left, as of get memory(); what is no such thing is left out.
  constructor({ kind, main, second, turns } = /** @type {any} */ ({})) {
    this.kind = KINDS.includes(kind) ? kind : "one";
    this.wanted = typeof main === "string" ? main : null;
    this.wantedSecond = typeof second === "string" ? second : null;
    this.seen = null;
    this.turns = {};
    for (const [id, turn] of Object.entries(turns ?? {})) {
      if ([90, 180, 270].includes(turn)) this.turns[id] = turn;
    }
    this.ids = [];
  }

  offer(ids) {
    this.ids = [...ids];
  }

  // The choice of a source that is not there yet, or no longer, is kept. What a person has seen a frame of stays until they
  // choose another.
  get main() {
    return [this.seen, this.wanted].find((id) => this.ids.includes(id)) ?? this.ids[0] ?? null;
  }

  // A frame of this source has been shown.
  keep(id) {
    if (id === this.main) this.seen = id;
  }

  get second() {
    const others = this.ids.filter((id) => id !== this.main);
    return others.includes(this.wantedSecond) ? this.wantedSecond : (others[0] ?? null);
  }

  // How they stand now: beside a map that is alone the camera goes on, as driving is held without it.
  get arranged() {
    return this.kind === "one" && this.main === MAP ? "inset" : this.kind;
  }

  // The ids in their order on the page. In the grid every one keeps its place, whichever is the main one.
  get shown() {
    const { main, second, arranged } = this;
    if (main === null) return [];
    if (arranged === "one" || second === null) return [main];
    if (arranged === "inset") return [main, second];
    const first = this.ids.slice(0, GRID_PLACES);
    return first.includes(main) ? first : [...first.slice(0, -1), main];
  }

  // Makes a source the main one; the one before becomes the inset.
  choose(id) {
    if (!this.ids.includes(id) || id === this.main) return;
    this.wantedSecond = this.main;
    this.wanted = id;
    this.seen = null;
  }

  nth(place) {
    this.choose(this.ids[place]);
  }

  next() {
    this.choose(this.ids[(this.ids.indexOf(this.main) + 1) % this.ids.length]);
  }

  use(kind) {
    if (KINDS.includes(kind)) this.kind = kind;
  }

  turn(id) {
    this.turns[id] = ((this.turns[id] ?? 0) + QUARTER) % 360;
  }

  // Degrees clockwise; `mounted` is how the robot's settings say that the camera is.
  turned(id, mounted = 0) {
    return (mounted + (this.turns[id] ?? 0)) % 360;
  }

  get memory() {
    return { kind: this.kind, main: this.wanted, second: this.wantedSecond, turns: this.turns };
  }
}
