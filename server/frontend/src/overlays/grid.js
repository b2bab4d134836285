// A nav_msgs/OccupancyGrid as pixels. Pure.

const MOST_CELLS = 16_000_000;
const FREE = [58, 70, 86];
const OCCUPIED = [236, 240, 246];

// One colour for each value of a signed byte, as it lies in memory: 0 free to 100 occupied, anything else unknown.
const COLOURS = new Uint32Array(256);
const bytes = new Uint8Array(COLOURS.buffer);
for (let value = 0; value <= 100; value++) {
  const mix = (channel) => FREE[channel] + ((OCCUPIED[channel] - FREE[channel]) * value) / 100;
  bytes.set([mix(0), mix(1), mix(2), 255], value * 4);
}

// Gives {width, height, pixels (RGBA, the first row is the map's lowest), resolution, origin {x, y, theta}}, or null for
// what is no map. `data` is a list of numbers, or base64 as some bridges write bytes.
export function gridPixels({ info, data }) {
  const { width, height, resolution, origin } = info ?? {};
  const cells = typeof data === "string" ? signedBytes(data) : data;
  if (!fits(width, height, resolution) || cells?.length !== width * height) return null;
  const pixels = new Uint32Array(cells.length);
  for (let i = 0; i < cells.length; i++) pixels[i] = COLOURS[cells[i] & 255];
  return {
    width,
    height,
    resolution,
    pixels: new Uint8ClampedArray(pixels.buffer),
    origin: planar(origin),
  };
}

const fits = (width, height, resolution) => width > 0 && height > 0 && width * height <= MOST_CELLS && resolution > 0;

const signedBytes = (base64) => Int8Array.from(atob(base64), (char) => char.charCodeAt(0));

// A geometry_msgs/Pose seen from above.
export function planar({ position, orientation } = {}) {
  const { x, y, z, w } = { x: 0, y: 0, z: 0, w: 1, ...orientation };
  const theta = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
  return { x: position?.x ?? 0, y: position?.y ?? 0, theta };
}
