// The robot from above in a tile of its own, which follows it. Drawn once a frame of the page at most, and only after something changed.

import { part, setText } from "../pages/page.js";
import { map as texts } from "../texts/video.js";
import { drawWorld } from "./mapDraw.js";

const ZOOMS = [4, 8, 16, 32, 64, 128]; // pixels a metre
const USUAL = 3;

export class MapTile {
  // `world` as of world.js; `memory()` gives {zoom, scan, path, map} as the person left it, or undefined; `onMemory` gets it
  // when that changes.
  constructor(element, { world, memory, onMemory }) {
    Object.assign(this, { element, world, onMemory });
    const left = memory() ?? {};
    this.canvas = part(element, "picture");
    this.canvas.setAttribute("aria-label", texts.label);
    this.zoom = left.zoom in ZOOMS ? left.zoom : USUAL;
    this.parts = { scan: left.scan !== false, path: left.path !== false, map: left.map !== false };
    this.listen();
  }

  listen() {
    for (const name of Object.keys(this.parts)) {
      const box = part(this.element, `map-${name}`);
      box.checked = this.parts[name];
      box.addEventListener("change", () => this.choose({ parts: { ...this.parts, [name]: box.checked } }));
    }
    part(this.element, "zoom-in").addEventListener("click", () => this.step(1));
    part(this.element, "zoom-out").addEventListener("click", () => this.step(-1));
  }

  step(by) {
    this.choose({ zoom: Math.min(ZOOMS.length - 1, Math.max(0, this.zoom + by)) });
  }

  choose(change) {
    Object.assign(this, change);
    if (this.running) this.world.show(this.parts);
    this.onMemory({ zoom: this.zoom, ...this.parts });
    this.draw();
  }

  start() {
    this.running = true;
    this.world.show(this.parts);
    this.draw();
  }

  stop() {
    this.running = false;
    this.world.show(null);
  }

  close() {
    this.stop();
    cancelAnimationFrame(this.frame);
    this.element.remove();
  }

  // What only a camera does.
  retryNow() {}

  turn() {}

  forget() {}

  ask() {
    this.draw();
  }

  // What is old is drawn no more, so that it is drawn anew also when nothing comes.
  showState() {
    this.draw();
  }

  draw() {
    if (!this.running) return;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      this.paint();
    });
  }

  paint() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.element;
    this.fit(Math.round(clientWidth * ratio), Math.round(clientHeight * ratio));
    drawWorld(this.canvas, this.world, { zoom: ZOOMS[this.zoom] * ratio, parts: this.parts });
    const empty = !this.world.odometry && !this.world.map && !this.world.points;
    setText(part(this.element, "words"), empty ? texts.nothing : "");
  }

  fit(width, height) {
    if (this.canvas.width !== width) this.canvas.width = width;
    if (this.canvas.height !== height) this.canvas.height = height;
  }
}
