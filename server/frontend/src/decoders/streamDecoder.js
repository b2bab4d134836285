// Decodes H.264 or VP8 with WebCodecs: one frame out for each frame in, at once.
// It must never hold a frame back, nor give one for another: driving is held by the age of what is seen.

import { formatOf } from "./keyFrames.js";

const OUT_MS = 200; // time limit for a frame to come out
const FIRST_OUT_MS = 1000; // and for the first one of a decoder, which has to start
const BUSY_MS = 100; // least delay of the timer itself by which a page counts as busy
const MAX_SIDE = 4096; // pixels, as of the frames protocol: a robot may send a few bytes that decode to gigabytes
const STEP_US = 1000;

export class KeyFrameMissingError extends Error {
  constructor() {
    super("cannot decode a frame: it depends on a key frame, and none has come");
  }
}

export class StreamDecoder {
  // `codec` is h264 or vp8; `hardwareAcceleration` as of VideoDecoderConfig.
  constructor({ codec, hardwareAcceleration }) {
    this.codec = codec;
    this.hardwareAcceleration = hardwareAcceleration;
    /** @type {ReturnType<typeof formatOf>} */
    this.format = null; // of the newest key frame
    this.started = false;
    this.timestamp = 0;
    this.pending = new Map(); // what waits for its frame, by timestamp
    this.decoder = new VideoDecoder({ output: (image) => this.receive(image), error: (error) => this.fail(error) });
  }

  // A browser ends the decoders of a page that has not used them for long.
  get isClosed() {
    return this.decoder.state === "closed";
  }

  // `frame` as of readFrame in client/frames.js. Gives a promise of a VideoFrame, which the caller closes. It rejects with
  // KeyFrameMissingError for a frame that depends on one that has not come; after any other error this decoder is of no use.
  async decode({ isKey, data }) {
    if (isKey) this.begin(data);
    if (!this.format) throw new KeyFrameMissingError();
    const timestamp = (this.timestamp += STEP_US);
    return new Promise((resolve, reject) => {
      this.pending.set(timestamp, { resolve, reject });
      this.watch(timestamp, this.started ? OUT_MS : FIRST_OUT_MS);
      this.decoder.decode(new EncodedVideoChunk({ type: isKey ? "key" : "delta", timestamp, data }));
    });
  }

  begin(data) {
    const format = formatOf(this.codec, data);
    if (!format) throw new Error(`cannot decode a key frame: it does not begin as one of ${this.codec} does`);
    checkSize(format.width, format.height);
    if (JSON.stringify(format) === JSON.stringify(this.format)) return;
    this.format = format;
    this.started = false;
    const { hardwareAcceleration } = this;
    const [codedWidth, codedHeight] = [format.width, format.height];
    this.decoder.configure({ codec: format.codec, codedWidth, codedHeight, hardwareAcceleration, optimizeForLatency: true });
  }

  // Chromium has decoders that give no frame and no error. A page that is hidden or busy gets none in time either.
  watch(timestamp, limitMs) {
    const due = performance.now() + limitMs;
    this.pending.get(timestamp).timer = setTimeout(() => {
      if (globalThis.document?.hidden || performance.now() - due > BUSY_MS) this.watch(timestamp, limitMs);
      else this.fail(new Error(`cannot decode a frame: nothing came out within ${limitMs} ms`));
    }, limitMs);
  }

  receive(image) {
    try {
      checkSize(image.codedWidth, image.codedHeight);
    } catch (error) {
      image.close();
      this.fail(error);
      return;
    }
    const waiting = this.pending.get(image.timestamp);
    this.pending.delete(image.timestamp);
    this.started = true;
    clearTimeout(waiting?.timer);
    if (waiting) waiting.resolve(image);
    else image.close();
  }

  fail(error) {
    for (const { reject, timer } of this.pending.values()) {
      clearTimeout(timer);
      reject(error);
    }
    this.pending.clear();
    if (!this.isClosed) this.decoder.close();
  }

  close() {
    this.fail(new Error("cannot decode a frame: the decoder was closed"));
  }
}

function checkSize(width, height) {
  if (Math.max(width, height) > MAX_SIDE) throw new Error(`cannot decode video of ${width}x${height}: ${MAX_SIDE} is the most`);
}
