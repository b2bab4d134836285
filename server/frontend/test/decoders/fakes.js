// A double of WebCodecs, which Node lacks: it decodes when the test says so.

export const bytes = (hex) => Uint8Array.from(hex.match(/../g), (pair) => parseInt(pair, 16));

// 640 x 480, and 4112 x 480: one macroblock more than may be across.
export const H264_KEY = bytes("000000016742c01eda0280f684000003000400000300f23c58ba800000000168ce0fc8");
export const HUGE_KEY = bytes("000000016742c01eda004043d9");

// 640 x 480, without its content.
export const JPEG = bytes("ffd8ffe00004ffc0ffc0000b0801e00280");

export class FakeVideoDecoder {
  /** @type {FakeVideoDecoder[]} */
  static made = [];

  static isConfigSupported = async () => ({ supported: false });

  static install() {
    FakeVideoDecoder.made = [];
    globalThis.VideoDecoder = FakeVideoDecoder;
    globalThis.EncodedVideoChunk = class {
      constructor(chunk) {
        Object.assign(this, chunk);
      }
    };
  }

  state = "unconfigured";
  chunks = [];

  constructor({ output, error }) {
    this.output = output;
    this.onError = error;
    FakeVideoDecoder.made.push(this);
  }

  configure(config) {
    this.config = config;
    this.state = "configured";
  }

  decode(chunk) {
    if (this.state !== "configured") throw new Error(`cannot decode: ${this.state}`);
    this.chunks.push(chunk);
  }

  close() {
    this.state = "closed";
  }

  error(error) {
    this.state = "closed";
    this.onError(error);
  }

  give(timestamp = this.chunks.at(-1).timestamp, more = {}) {
    const image = { timestamp, codedWidth: 640, codedHeight: 480, close: () => (image.closed = true), ...more };
    this.output(image);
    return image;
  }
}
