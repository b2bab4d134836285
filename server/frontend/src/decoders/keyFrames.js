// Reads in a key frame what a decoder needs to know before it: codec string and size (ITU-T H.264, 7.3.2.1.1; RFC 6386, 9.1).
// Robots write these frames, so nothing in one is trusted. Pure.

const SEQUENCE_PARAMETER_SET = 7;
const MAX_SEARCHED = 1024; // bytes: a key frame begins with its parameter sets
// Profiles whose parameter sets say more of the colours.
const HIGH_PROFILES = [44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244];
const BLOCK = 16; // pixels of a macroblock's side
const MAX_CYCLE = 255;

// `codec` is h264 or vp8. Gives {codec, width, height}, the codec as WebCodecs names it and the coded size in pixels; null for
// what is not a key frame of that codec.
/** @returns {{codec: string, width: number, height: number} | null} */
export function formatOf(codec, data) {
  return codec === "vp8" ? vp8Format(data) : h264Format(data);
}

function vp8Format(data) {
  const isKey = data.length >= 10 && !(data[0] & 1) && data[3] === 0x9d && data[4] === 0x01 && data[5] === 0x2a;
  const side = (at) => (data[at] | (data[at + 1] << 8)) & 0x3fff;
  return isKey ? { codec: "vp8", width: side(6), height: side(8) } : null;
}

function h264Format(data) {
  const set = parameterSet(data.subarray(0, MAX_SEARCHED));
  if (!set || set.length < 4) return null;
  const bits = new Bits(set.subarray(3));
  bits.number(); // its own number
  if (HIGH_PROFILES.includes(set[0])) skipColours(bits);
  bits.number(); // of frames' numbers
  skipOrder(bits);
  bits.number(); // reference frames
  bits.bit(); // gaps in frames' numbers
  const width = (bits.number() + 1) * BLOCK;
  const rows = (bits.number() + 1) * BLOCK;
  const height = bits.bit() ? rows : rows * 2; // fields count twice
  return bits.isOver ? null : { codec: `avc1.${hex(set.subarray(0, 3))}`, width, height };
}

const hex = (bytes) => [...bytes].map((byte) => byte.toString(16).padStart(2, "0").toUpperCase()).join("");

// Without the byte that keeps zeros from looking like a start code.
function parameterSet(data) {
  const isStart = (at) => !data[at - 3] && !data[at - 2] && data[at - 1] === 1;
  const at = data.findIndex((byte, i) => i > 2 && isStart(i) && (byte & 31) === SEQUENCE_PARAMETER_SET);
  if (at < 0) return null;
  const escaped = data.subarray(at + 1);
  return escaped.filter((byte, i) => !(byte === 3 && i > 1 && !escaped[i - 1] && !escaped[i - 2]));
}

function skipColours(bits) {
  const chroma = bits.number();
  if (chroma === 3) bits.bit();
  bits.number(); // bits of a pixel's brightness
  bits.number(); // and of its colour
  bits.bit();
  if (!bits.bit()) return;
  for (let list = 0; list < (chroma === 3 ? 12 : 8); list++) if (bits.bit()) skipScaling(bits, list < 6 ? 16 : 64);
}

function skipScaling(bits, size) {
  let [last, next] = [8, 8];
  for (let i = 0; i < size && next; i++) {
    next = (last + bits.signed() + 256) % 256;
    last = next || last;
  }
}

function skipOrder(bits) {
  const kind = bits.number();
  if (kind === 0) bits.number();
  if (kind !== 1) return;
  bits.bit();
  bits.number();
  bits.number();
  for (let count = Math.min(bits.number(), MAX_CYCLE); count > 0; count--) bits.number();
}

// Bits from the first on; zeros after the last.
class Bits {
  constructor(bytes) {
    this.bytes = bytes;
    this.at = 0;
  }

  get isOver() {
    return this.at > this.bytes.length * 8;
  }

  bit() {
    const byte = this.bytes[this.at >> 3] ?? 0;
    const bit = (byte >> (7 - (this.at & 7))) & 1;
    this.at += 1;
    return bit;
  }

  // In Exp-Golomb code, of 32 bits at most.
  number() {
    let zeros = 0;
    while (zeros < 32 && !this.bit()) zeros += 1;
    let value = 1;
    for (; zeros > 0; zeros--) value = value * 2 + this.bit();
    return value - 1;
  }

  signed() {
    const number = this.number();
    return number % 2 ? (number + 1) / 2 : -number / 2;
  }
}
