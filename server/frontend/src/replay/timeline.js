// The time line: a slider for people, and below it when there is video, when somebody drove and when the robot was stopped.

import { part, setText } from "../dom/page.js";
import { replay as texts } from "../texts/replay.js";

const STEP_MS = 5000;
const FINE_MS = 1000;

// Where a key leads; undefined for one that leads nowhere. Up and down scroll the page, except on the slider. Pure.
/** @param {{key: string, shiftKey?: boolean, target?: any}} event @param {number} atMs @param {number} durationMs */
export function keyTarget({ key, shiftKey = false, target = null }, atMs, durationMs) {
  const step = shiftKey ? FINE_MS : STEP_MS;
  /** @type {Record<string, number>} */
  const targets = { ArrowLeft: atMs - step, ArrowRight: atMs + step, Home: 0, End: durationMs };
  if (target?.type === "range") Object.assign(targets, { ArrowDown: targets.ArrowLeft, ArrowUp: targets.ArrowRight });
  return targets[key];
}

// A span as parts of the line, {from, width} from 0 to 1. Pure.
export function share({ fromMs, toMs }, durationMs) {
  const whole = Math.max(durationMs, 1);
  const from = Math.min(Math.max(fromMs / whole, 0), 1);
  return { from, width: Math.min(Math.max((toMs - fromMs) / whole, 0), 1 - from) };
}

export class Timeline {
  // `onSeek(ms)` is called while somebody moves the slider or a finger on the tracks, too.
  constructor(root, { durationMs, onSeek }) {
    this.root = root;
    this.durationMs = durationMs;
    this.onSeek = onSeek;
    this.slider = part(root, "slider");
    this.tracks = part(root, "tracks");
    this.slider.max = String(Math.ceil(durationMs));
    this.slider.addEventListener("input", () => onSeek(Number(this.slider.value)));
    this.listen();
    new ResizeObserver(() => this.draw()).observe(this.tracks);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  listen() {
    const seek = ({ clientX }) => {
      const { left, width } = this.lines.getBoundingClientRect();
      this.onSeek(((clientX - left) / width) * this.durationMs);
    };
    this.tracks.addEventListener("pointerdown", (event) => {
      this.tracks.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.tracks.addEventListener("pointermove", (event) => this.tracks.hasPointerCapture(event.pointerId) && seek(event));
  }

  get lines() {
    return part(this.root, "head").parentElement;
  }

  // `rows` by the name of their canvas, each spans.
  use(rows) {
    this.rows = rows;
    this.draw();
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    for (const [name, spans] of Object.entries(this.rows ?? {})) {
      const canvas = part(this.root, `track-${name}`);
      canvas.width = Math.round(canvas.clientWidth * ratio);
      canvas.height = Math.round(canvas.clientHeight * ratio);
      const context = canvas.getContext("2d");
      context.fillStyle = getComputedStyle(canvas).color;
      for (const span of spans) {
        const { from, width } = share(span, this.durationMs);
        context.fillRect(from * canvas.width, 0, Math.max(width * canvas.width, ratio), canvas.height);
      }
    }
  }

  show(atMs) {
    if (this.shownMs === atMs) return;
    this.shownMs = atMs;
    const words = texts.at(atMs, this.durationMs);
    if (this.words !== words) this.slider.setAttribute("aria-valuetext", words);
    this.words = words;
    this.slider.value = String(Math.round(atMs));
    setText(part(this.root, "clock"), words);
    part(this.root, "head").style.left = `${share({ fromMs: atMs, toMs: atMs }, this.durationMs).from * 100}%`;
  }
}
