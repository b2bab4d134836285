// What the robot's laser sees, drawn in the stick: ahead is up, and the rim is as far as a driver has to look.
// Without a scan it says so: an empty ring would be free space.

import { ring as texts } from "../texts/video.js";

const RANGE_M = 3;
const NEAR_M = 1;
const DOT_PX = 3;
const COLOURS = { far: "#7c8aa0", near: "#e0483f" };
const WORDS = { at: 0.22, size: 0.1 }; // above the knob, as parts of the ring's width

export class LaserRing {
  // `world` as of world.js.
  constructor(canvas, world) {
    this.canvas = canvas;
    this.world = world;
    this.shown = false;
  }

  // What is not shown is not subscribed to.
  show(shown) {
    this.shown = shown;
    this.canvas.hidden = !shown;
    this.world.showRing(shown);
    this.draw();
  }

  draw() {
    if (!this.shown) return;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      this.paint();
    });
  }

  paint() {
    const { canvas } = this;
    const context = canvas.getContext("2d");
    canvas.width = canvas.height = canvas.clientWidth * (window.devicePixelRatio || 1);
    const middle = canvas.width / 2;
    const dot = (DOT_PX * canvas.width) / (canvas.clientWidth || 1);
    const { points } = this.world;
    if (!points) return this.say(context, canvas.width);
    for (const { x, y, near } of ringPoints(points)) {
      context.fillStyle = near ? COLOURS.near : COLOURS.far;
      context.fillRect(middle * (1 + x) - dot / 2, middle * (1 + y) - dot / 2, dot, dot);
    }
  }

  say(context, width) {
    Object.assign(context, { fillStyle: COLOURS.far, font: `${WORDS.size * width}px sans-serif`, textAlign: "center" });
    context.fillText(texts.silent, width / 2, WORDS.at * width);
  }
}

// `points` as of scanPoints, x ahead and y to the left in m. Gives those in range, from -1 to 1, x to the right and y down.
export function ringPoints(points) {
  const places = [];
  for (let i = 0; i < points.length; i += 2) {
    const [ahead, left] = [points[i], points[i + 1]];
    const away = Math.hypot(ahead, left);
    if (away <= RANGE_M) places.push({ x: 0 - left / RANGE_M, y: 0 - ahead / RANGE_M, near: away < NEAR_M });
  }
  return places;
}
