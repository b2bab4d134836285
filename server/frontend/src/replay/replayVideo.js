// The picture of a recording: decodes the frames of one camera in their order and shows the one that is due. A frame that cannot be
// decoded leaves no picture that is older than it.

import { Painter } from "../client/painter.js";
import { DecoderChoice, FrameDecoder } from "../decoders/frameDecoder.js";
import { formatOf } from "../decoders/keyFrames.js";
import { KeyFrameMissingError } from "../decoders/streamDecoder.js";
import { part, setText } from "../dom/page.js";
import { replay as texts } from "../texts/replay.js";
import { compareCameras } from "../topics/discovery.js";

const GAP_MS = 1500; // time after which a frame is no longer what the camera saw
const MAX_WAITING = 400; // frames that wait for the decoder
const CODECS = ["h264", "vp8"];
const IMAGE = /^sensor_msgs\/(?:msg\/)?CompressedImage$/;
const VIDEO = /^foxglove_msgs\/(?:msg\/)?CompressedVideo$/;

/** @typedef {{codec: string, isKey: boolean, data: Uint8Array, atMs: number}} Frame */

// The cameras of a recording, by what the recorder calls their topics: [{name, topics}], in the order of the drive page: as the settings
// have them in `configured`, then the usual one, then by name. Pure.
/** @param {{name: string, type: string}[]} topics @param {string[]} configured */
export function camerasOf(topics, configured) {
  const cameras = new Map();
  for (const { name, type } of topics) {
    const [ending] = [IMAGE.test(type) && "/compressed", VIDEO.test(type) && "/video"].filter(Boolean);
    if (!ending || !name.endsWith(ending) || name === ending) continue;
    const camera = name.slice(0, -ending.length);
    cameras.set(camera, [...(cameras.get(camera) ?? []), name]);
  }
  return inOrder(cameras, configured).map((name) => ({ name, topics: cameras.get(name) }));
}

// In the file they are as their first frames came.
function inOrder(cameras, configured) {
  const chosen = configured.filter((name) => cameras.has(name));
  return [...new Set([...chosen, ...[...cameras.keys()].sort(compareCameras)])];
}

// `message` as it was decoded; null for what is not a frame that the recorder writes. Pure.
/** @returns {Frame | null} */
export function frameOf(message, atMs) {
  const { format, data } = message ?? {};
  if (!(data instanceof Uint8Array)) return null;
  if (format === "jpeg") return { codec: "jpeg", isKey: true, data, atMs };
  return CODECS.includes(format) ? { codec: format, isKey: Boolean(formatOf(format, data)), data, atMs } : null;
}

export class ReplayVideo {
  constructor(element, { painter = new Painter(part(element, "canvas")), makeDecoder = newDecoder } = {}) {
    this.element = element;
    this.painter = painter;
    this.makeDecoder = makeDecoder;
    /** @type {any} */
    this.decoder = null;
    this.round = 0;
    /** @type {{frame: Frame, isShown: boolean}[]} */
    this.frames = [];
    this.shownMs = this.newestMs = -Infinity;
    this.problem = "";
    this.reset([]);
  }

  // After a seek: these are decoded, and the last is shown.
  reset(frames) {
    this.decoder?.close();
    this.decoder = this.makeDecoder();
    this.round += 1;
    this.frames = [];
    this.shownMs = this.newestMs = -Infinity;
    this.problem = "";
    this.push(frames);
  }

  // What is due; the last of it is shown.
  /** @param {Frame[]} frames */
  push(frames) {
    const last = frames.at(-1);
    if (!last) return;
    for (const frame of frames) this.frames.push({ frame, isShown: frame === last });
    this.newestMs = last.atMs;
    if (this.frames.length > MAX_WAITING) this.skip();
    this.run();
  }

  // The decoder is too slow: it goes on at the newest key frame.
  skip() {
    const key = this.frames.map(({ frame }) => frame.isKey).lastIndexOf(true);
    this.frames.splice(0, key > 0 ? key : this.frames.length);
  }

  async run() {
    if (this.running) return;
    this.running = true;
    for (let next = this.frames.shift(); next; next = this.frames.shift()) {
      const isPassed = next.frame.codec === "jpeg" && this.frames.length > 0; // by one that can be shown without it
      if (!isPassed) await this.decode(next);
    }
    this.running = false;
  }

  async decode({ frame, isShown }) {
    const { round, decoder } = this;
    try {
      await decoder.choice?.ready; // what the browser decodes
      const image = await decoder.decode(frame);
      if (round === this.round && isShown) this.paint(image, frame);
      else image.close();
    } catch (error) {
      if (round === this.round) this.fail(error);
    }
  }

  paint(image, { atMs }) {
    this.painter.show(image);
    this.shownMs = atMs;
    this.problem = "";
  }

  fail(error) {
    this.problem = error instanceof KeyFrameMissingError ? texts.noKeyFrame : texts.undecodable;
    this.shownMs = -Infinity;
  }

  // `isRecorded`: there is a camera in the recording; `loading`: a frame may still come.
  show(atMs, { isRecorded, loading }) {
    const isFresh = atMs - this.shownMs <= GAP_MS;
    this.element.dataset.frame = isFresh ? "live" : loading || this.isPending(atMs) ? "pending" : "none";
    setText(part(this.element, "words"), isFresh ? "" : isRecorded ? this.missing(atMs, loading) : texts.noVideo);
  }

  // Whether a frame that is due is with the decoder.
  isPending(atMs) {
    return atMs - this.newestMs <= GAP_MS && !this.problem;
  }

  missing(atMs, loading) {
    if (loading || this.isPending(atMs)) return texts.loading;
    return atMs - this.newestMs <= GAP_MS ? this.problem : texts.gap;
  }
}

// What failed before a seek may have been the recording's own fault.
const newDecoder = () => new FrameDecoder({ choice: new DecoderChoice(), onKeyFrame: () => {}, onCodecs: () => {} });
