// The robot's frames (tf2_msgs/TFMessage), and where one is in another. Pure.

import { unitQuaternion } from "../client/rosbridge.js";

const MAX_FRAMES = 1000;
const NOWHERE = { translation: { x: 0, y: 0, z: 0 }, rotation: { x: 0, y: 0, z: 0, w: 1 }, fixed: true, at: Infinity };

/**
 * @typedef {{x: number, y: number, z: number}} Vector
 * @typedef {Vector & {w: number}} Quaternion
 * @typedef {{translation: Vector, rotation: Quaternion, fixed: boolean, at: number}} Transform `at`: when the oldest of its
 *   parts that are not fixed came
 */

// tf names frames with a slash before them, tf2 without.
export const plainFrame = (name) => (typeof name === "string" ? name.replace(/^\//, "") : "");

export class Transforms {
  constructor() {
    /** @type {Map<string, Transform & {parent: string}>} */
    this.frames = new Map(); // by the child's name
  }

  // `fixed` of /tf_static, which comes once.
  receive({ transforms }, { fixed, at }) {
    if (!Array.isArray(transforms)) return;
    for (const transform of transforms.slice(0, MAX_FRAMES)) this.add(transform, { fixed, at });
  }

  add(stamped, source) {
    const { header, child_frame_id, transform } = stamped ?? {};
    const [parent, child] = [plainFrame(header?.frame_id), plainFrame(child_frame_id)];
    const read = readTransform(transform);
    if (!parent || !child || !read) return;
    if (this.frames.has(child) || this.frames.size < MAX_FRAMES) this.frames.set(child, { ...read, ...source, parent });
  }

  // Where the frame `source` is in the frame `target`; null if the two are not known to be connected.
  /** @type {(target: string, source: string) => Transform | null} */
  find(target, source) {
    const [ups, downs] = [this.ancestors(plainFrame(source)), this.ancestors(plainFrame(target))];
    for (const [frame, up] of ups) {
      const down = downs.get(frame);
      if (down) return chained(inverted(down), up);
    }
    return null;
  }

  // The frame itself and those above it, each with where the frame is in it.
  ancestors(frame) {
    const places = new Map(frame ? [[frame, NOWHERE]] : []);
    let [below, link] = [frame, this.frames.get(frame)];
    while (link && !places.has(link.parent)) {
      // a circle of frames has no end
      places.set(link.parent, chained(link, places.get(below)));
      [below, link] = [link.parent, this.frames.get(link.parent)];
    }
    return places;
  }
}

// `points`, x and y in turn, of a plane that lies in a frame as `transform` says; gives them as seen from above.
/** @type {(points: Float32Array, transform: Transform) => Float32Array} */
export function projected(points, { translation, rotation }) {
  const [ahead, left] = [rotated(rotation, { x: 1, y: 0, z: 0 }), rotated(rotation, { x: 0, y: 1, z: 0 })];
  const seen = new Float32Array(points.length);
  for (let i = 0; i < points.length; i += 2) {
    seen[i] = translation.x + ahead.x * points[i] + left.x * points[i + 1];
    seen[i + 1] = translation.y + ahead.y * points[i] + left.y * points[i + 1];
  }
  return seen;
}

// Null for what is not a transform.
function readTransform(transform) {
  const { x, y, z } = transform?.translation ?? {};
  const rotation = unitQuaternion(transform?.rotation);
  return rotation && [x, y, z].every(Number.isFinite) ? { translation: { x, y, z }, rotation } : null;
}

// Where what `inner` places in a frame is, if `outer` places that frame.
function chained(outer, inner) {
  const moved = rotated(outer.rotation, inner.translation);
  const { x, y, z } = outer.translation;
  return {
    translation: { x: x + moved.x, y: y + moved.y, z: z + moved.z },
    rotation: multiplied(outer.rotation, inner.rotation),
    fixed: outer.fixed && inner.fixed,
    at: Math.min(timeOf(outer), timeOf(inner)),
  };
}

const timeOf = ({ fixed, at }) => (fixed ? Infinity : at);

function inverted({ translation, rotation: { x, y, z, w }, ...rest }) {
  const rotation = { x: -x, y: -y, z: -z, w };
  const back = rotated(rotation, translation);
  return { ...rest, rotation, translation: { x: -back.x, y: -back.y, z: -back.z } };
}

const multiplied = (a, b) => ({
  x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
  y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
  z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
  w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
});

function rotated(rotation, { x, y, z }) {
  const { x: a, y: b, z: c, w } = rotation;
  const back = { x: -a, y: -b, z: -c, w };
  return multiplied(multiplied(rotation, { x, y, z, w: 0 }), back);
}
