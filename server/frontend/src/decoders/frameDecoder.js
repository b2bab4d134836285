// Decodes a camera's frames of any codec, and goes over to the next decoder where one fails: shared by the drive page and, through
// client/index.js, by pages of others.

import { jpegBlob } from "./jpeg.js";
import { KeyFrameMissingError, StreamDecoder } from "./streamDecoder.js";

// Their codec strings, to ask the browser: H.264 in Main profile up to 1080p.
const ASKED = { h264: "avc1.4D0028", vp8: "vp8" };
const JPEG = "jpeg"; // every browser decodes it
const REMEMBER_MS = 60_000; // time for which a failure counts
// Maximum number of failures that count: the first leads to software, and a device that was busy may have more.
const MAX_FAILURES = 1;
const MAX_FAILURES_OF_WORKING = 3;

/**
 * @typedef {{codecs: string[], failures: Record<string, number[]>, working: string[]}} Choice codecs to ask for, best first; when
 *   each failed, in ms; and those of which frames have come out
 */

// What to decode with after a failure: the same codec in software, and when it fails too often, no more of that codec. Pure.
/** @param {Choice} choice @param {string} codec @param {number} now @returns {Choice} */
export function afterFailure({ codecs, failures, working }, codec, now) {
  const counted = [...(failures[codec] ?? []).filter((at) => now - at <= REMEMBER_MS), now];
  const goesOn = counted.length <= (working.includes(codec) ? MAX_FAILURES_OF_WORKING : MAX_FAILURES);
  return { codecs: goesOn ? codecs : codecs.filter((name) => name !== codec), failures: { ...failures, [codec]: counted }, working };
}

// What this page asks for and decodes with, as long as it is open: another page may have another decoder.
export class DecoderChoice {
  constructor({ supported = supportedCodecs() } = {}) {
    /** @type {Choice} */
    this.choice = { codecs: [JPEG], failures: {}, working: [] };
    this.ready = supported.then((codecs) => (this.choice = { ...this.choice, codecs }));
  }

  // JPEG alone until it is known what the browser decodes: see `ready`.
  get codecs() {
    return this.choice.codecs;
  }

  /** @returns {HardwareAcceleration} */
  accelerationOf(codec) {
    return codec in this.choice.failures ? "prefer-software" : "no-preference";
  }

  succeed(codec) {
    const { working } = this.choice;
    if (!working.includes(codec)) this.choice = { ...this.choice, working: [...working, codec] };
  }

  fail(codec) {
    this.choice = afterFailure(this.choice, codec, performance.now());
  }
}

/** @type {Promise<string[]> | undefined} */
let browserCodecs;

// Asked once a page, the best first. There is no VideoDecoder in older browsers, nor on pages without TLS.
function supportedCodecs() {
  return (browserCodecs ??= Promise.all(Object.keys(ASKED).map(supports)).then((answers) => [...answers.flat(), JPEG]));
}

async function supports(name) {
  const config = { codec: ASKED[name], optimizeForLatency: true };
  const answer = await globalThis.VideoDecoder?.isConfigSupported(config).catch(() => null);
  return answer?.supported ? [name] : [];
}

export class FrameDecoder {
  // `choice` is a DecoderChoice. `onKeyFrame()`: nothing can be decoded before a key frame. `onCodecs()`: `choice` has other codecs
  // to ask for.
  constructor({ choice, onKeyFrame, onCodecs }) {
    this.choice = choice;
    this.onKeyFrame = onKeyFrame;
    this.onCodecs = onCodecs;
    /** @type {StreamDecoder | null} */
    this.decoder = null;
  }

  // `frame` as of readFrame in client/frames.js, in their order. Gives a promise of what drawImage takes, which the caller closes.
  async decode(frame) {
    const { codec } = frame;
    if (codec === JPEG) return createImageBitmap(jpegBlob(frame.data));
    if (!this.choice.codecs.includes(codec)) throw new Error(`cannot decode a frame: ${codec} has failed on this page`);
    const decoder = this.decoderOf(codec);
    try {
      const image = await decoder.decode(frame);
      this.choice.succeed(codec);
      return image;
    } catch (error) {
      if (decoder === this.decoder) this.receiveError(codec, error);
      throw error;
    }
  }

  decoderOf(codec) {
    const { decoder } = this;
    if (decoder && decoder.codec === codec && !decoder.isClosed) return decoder;
    this.close();
    return (this.decoder = new StreamDecoder({ codec, hardwareAcceleration: this.choice.accelerationOf(codec) }));
  }

  receiveError(codec, error) {
    if (!(error instanceof KeyFrameMissingError)) {
      this.close();
      this.choice.fail(codec);
    }
    if (this.choice.codecs.includes(codec)) this.onKeyFrame();
    else this.onCodecs();
  }

  // What comes next does not continue what was decoded, or nothing comes; the next frame opens a new one.
  close() {
    const { decoder } = this;
    this.decoder = null;
    decoder?.close();
  }
}
