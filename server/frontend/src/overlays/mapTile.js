// The robot from above in a tile of its own, which follows it. Drawn once a frame of the page at most, and only after
// something changed.

import { fitCanvas } from "../client/painter.js";
import { decimalText, part, setText } from "../dom/page.js";
import { map as texts } from "../texts/video.js";

const ZOOMS = [4, 8, 16, 32, 64, 128]; // pixels a metre
const USUAL = 3;
const SMALL_STEPS = 2; // by which the small map shows more around the robot, as it has a quarter of the width

export class MapTile {
  // `world` as of world.js; `memory()` gives {zoom, scan, path, map} as the person left it; `onMemory` gets it
  // when that changes. `small`: without tools.
  /** @param {any} element @param {{world: any, memory?: () => any, onMemory?: (map: object) => void, small?: boolean}} options */
  constructor(element, { world, memory = () => ({}), onMemory = () => {}, small = false }) {
    this.element = element;
    this.world = world;
    this.memory = memory;
    this.onMemory = onMemory;
    this.canvas = part(element, "canvas");
    this.canvas.setAttribute("aria-label", texts.label);
    const { zoom } = memory();
    this.zoom = Math.max(0, (Number.isInteger(zoom) && zoom in ZOOMS ? zoom : USUAL) - (small ? SMALL_STEPS : 0));
    this.parts = partsOf(memory());
    if (!small) this.listen();
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
    this.parts = partsOf(this.memory()); // the person may have chosen others on the other map
    this.world.show(this.parts);
    this.draw();
  }

  // Of what another tile shows of the same world it takes nothing away.
  stop() {
    if (!this.running) return;
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
    const { robot } = this.world;
    setText(part(this.element, "pose"), robot.old || isLost(this.world, this.parts) ? "" : poseText(robot));
    this.showScale();
  }

  // How long a metre is, or five or more where one is too short to see.
  showScale() {
    const scale = part(this.element, "scale");
    const zoom = ZOOMS[this.zoom];
    const metres = stepOf(MIN_SCALE_PX, zoom);
    setText(scale, texts.scale(metres));
    scale.style.width = `${metres * zoom}px`;
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
    fitCanvas(this.canvas, Math.round(clientWidth * ratio), Math.round(clientHeight * ratio));
    const { world, parts } = this;
    drawWorld(this.canvas, world, { zoom: ZOOMS[this.zoom] * ratio, parts, empty: isEmpty(world, parts) });
    setText(part(this.element, "words"), wordsOf(world, parts));
  }
}

const poseText = ({ x, y, theta }) => texts.pose(decimalText(x, 1), decimalText(y, 1), decimalText((theta * 180) / Math.PI, 0));

const partsOf = ({ scan, path, map }) => ({ scan: scan !== false, path: path !== false, map: map !== false });

// Draws the robot from above: map, path, scan and itself, in the middle of a canvas. Draws only; world.js knows.
const COLOURS = { grid: "#232b36", path: "#5aa9ff", scan: "#ff6b6b", robot: "#ffb000", old: "#8a94a3" };
const ROBOT_M = 0.3;
const MIN_ROBOT_PX = 9;
const MIN_GRID_PX = 14;
const MIN_SCALE_PX = 30;

// Whether neither the robot's place nor a wanted part is known.
export const isEmpty = ({ robot, map, points }, parts) => Boolean(robot.unknown) && !(parts.map && map) && !(parts.scan && points);

// Whether a map is drawn, and nobody knows where in it the robot is.
export const isLost = ({ robot, map }, parts) => Boolean(parts.map && map && (robot.unknown || robot.unplaced));

// What is said over the drawing.
export function wordsOf(world, parts) {
  if (parts.map && world.mapUnread) return texts.unread;
  if (isEmpty(world, parts)) return texts.nothing;
  if (isLost(world, parts)) return texts.lost;
  return parts.scan && world.isScanSilent ? texts.silentScan : "";
}

// `zoom` in device pixels a metre. `parts` {scan, path, map}: what is wanted to be seen.
function drawWorld(canvas, world, { zoom, parts, empty }) {
  const context = canvas.getContext("2d");
  const { robot } = world;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, canvas.width, canvas.height);
  if (empty) return; // an arrow would be a place
  // From here on in metres, y up, the robot in the middle.
  context.setTransform(zoom, 0, 0, -zoom, canvas.width / 2 - robot.x * zoom, canvas.height / 2 + robot.y * zoom);
  drawGrid(context, canvas, robot, zoom);
  if (parts.map && world.map) drawMap(context, world.map);
  if (isLost(world, parts)) return;
  if (parts.path) within(context, world.offset, () => drawPath(context, world.path.points, zoom));
  within(context, robot, () => {
    if (parts.scan && world.points) drawScan(context, world.points, zoom);
    drawRobot(context, robot.old, zoom);
  });
}

const stepOf = (minPx, zoom) => [1, 5, 10, 50, 100].find((metres) => metres * zoom >= minPx) ?? 500;

function within(context, { x, y, theta }, draw) {
  context.save();
  context.translate(x, y);
  context.rotate(theta);
  draw();
  context.restore();
}

// A line a metre, or every five or more where they would stand too close.
function drawGrid(context, canvas, { x, y }, zoom) {
  const step = stepOf(MIN_GRID_PX, zoom);
  const [across, up] = [canvas.width / zoom / 2, canvas.height / zoom / 2];
  context.beginPath();
  for (const at of multiples(step, x - across, x + across)) {
    context.moveTo(at, y - up);
    context.lineTo(at, y + up);
  }
  for (const at of multiples(step, y - up, y + up)) {
    context.moveTo(x - across, at);
    context.lineTo(x + across, at);
  }
  stroke(context, COLOURS.grid, 1 / zoom);
}

// The multiples of `step` between two numbers. They are counted: at a place of 17 digits, one step more is the same number.
export function multiples(step, least, most) {
  const first = Math.ceil(least / step);
  return Array.from({ length: Math.floor(most / step) - first + 1 }, (_, i) => (first + i) * step);
}

// The first row of the image is the map's lowest, and y goes up here: so it stands right.
function drawMap(context, { bitmap, origin, resolution }) {
  within(context, origin, () => {
    context.imageSmoothingEnabled = false;
    context.scale(resolution, resolution);
    context.drawImage(bitmap, 0, 0);
  });
}

function drawPath(context, points, zoom) {
  context.beginPath();
  for (const { x, y } of points) context.lineTo(x, y);
  context.lineJoin = "round";
  stroke(context, COLOURS.path, 2.5 / zoom);
}

function drawScan(context, points, zoom) {
  const size = 3 / zoom;
  context.fillStyle = COLOURS.scan;
  for (let i = 0; i < points.length; i += 2) {
    context.fillRect(points[i] - size / 2, points[i + 1] - size / 2, size, size);
  }
}

function drawRobot(context, old, zoom) {
  const radius = Math.max(ROBOT_M, MIN_ROBOT_PX / zoom);
  context.beginPath();
  context.moveTo(radius, 0);
  context.lineTo(-radius, radius * 0.75);
  context.lineTo(-radius * 0.5, 0);
  context.lineTo(-radius, -radius * 0.75);
  context.closePath();
  context.fillStyle = old ? COLOURS.old : COLOURS.robot;
  context.fill();
}

function stroke(context, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
}
