// Draws the numbers of the last minute on a canvas, newest at the right.

const MINUTE_MS = 60_000;
const PADDING = 4;

// The points as places on a canvas of this size; what does not change lies in the middle. Pure.
export function places(points, { now, min, max }, { width, height }) {
  const span = max - min;
  const room = height - 2 * PADDING;
  return points.map(({ value, at }) => ({
    x: width * (1 - (now - at) / MINUTE_MS),
    y: PADDING + room * (span > 0 ? 1 - (value - min) / span : 0.5),
  }));
}

// `extent` as of samples.js's LastMinute, or null.
export function drawPlot(canvas, points, extent, now) {
  const scale = window.devicePixelRatio || 1;
  const size = { width: canvas.clientWidth, height: canvas.clientHeight };
  canvas.width = Math.round(size.width * scale);
  canvas.height = Math.round(size.height * scale);
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  context.clearRect(0, 0, size.width, size.height);
  if (!extent) return;
  context.strokeStyle = getComputedStyle(canvas).color;
  context.lineWidth = 2;
  context.beginPath();
  for (const { x, y } of places(points, { now, ...extentOf(extent) }, size)) context.lineTo(x, y);
  context.stroke();
}

const extentOf = ({ min, max }) => ({ min, max });
