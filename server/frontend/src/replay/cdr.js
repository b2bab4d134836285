// Reads messages in CDR, ROS 2's encoding, by the definitions that a recording has of them: the other end of cdr.py in the recorder.
// Definitions and messages may be a hostile robot's, so every length is checked before anything is made of it. Pure.

import { plainType } from "../client/rosbridge.js";

/** @typedef {{name: string, type: string, length: number | null}} Field `length`: null one value, 0 a sequence, else an array */

const MAX_DEFINITION_CHARS = 200_000;
const MAX_FIELDS = 5000;
const MAX_DEPTH = 16;
const MAX_VALUES = 500_000; // of a message; bytes, as of a map, are one
const SEPARATOR = /^=+$/m;
const HEAD_BYTES = 4; // 0 1 0 0: CDR, little endian
const FIELD = /^([A-Za-z][\w/]*)(?:\[(\d*)\])?\s+([A-Za-z]\w*)$/;
const BYTES = ["uint8", "byte", "char"];
const EMPTY = [{ name: "empty", type: "uint8", length: null }]; // what stands for no fields

/** @type {Record<string, [number, (view: DataView, at: number) => any]>} */
const NUMBERS = {
  bool: [1, (view, at) => view.getUint8(at) !== 0],
  byte: [1, (view, at) => view.getUint8(at)],
  char: [1, (view, at) => view.getUint8(at)],
  int8: [1, (view, at) => view.getInt8(at)],
  uint8: [1, (view, at) => view.getUint8(at)],
  int16: [2, (view, at) => view.getInt16(at, true)],
  uint16: [2, (view, at) => view.getUint16(at, true)],
  int32: [4, (view, at) => view.getInt32(at, true)],
  uint32: [4, (view, at) => view.getUint32(at, true)],
  int64: [8, (view, at) => Number(view.getBigInt64(at, true))],
  uint64: [8, (view, at) => Number(view.getBigUint64(at, true))],
  float32: [4, (view, at) => view.getFloat32(at, true)],
  float64: [8, (view, at) => view.getFloat64(at, true)],
};

export class CdrError extends Error {}

// Gives the function that reads a message of this type out of its bytes; it throws CdrError.
/** @param {string} type @param {string} definition as `ros2msg` @returns {(data: Uint8Array) => any} */
export function decoderOf(type, definition) {
  const types = typesOf(type, definition);
  return (data) => {
    if (data.length < HEAD_BYTES || data[0] !== 0 || data[1] !== 1) throw new CdrError("no CDR of ours");
    return new Reader(data.subarray(HEAD_BYTES), types).struct(plainType(type), 0);
  };
}

/** @returns {Map<string, Field[]>} */
function typesOf(type, definition) {
  if (definition.length > MAX_DEFINITION_CHARS) throw new CdrError("a definition that is too long");
  const [own, ...inner] = definition.split(SEPARATOR);
  const types = new Map([[plainType(type), fieldsOf(own)]]);
  for (const text of inner) {
    const [, name, fields] = /^\s*MSG: (\S+)\n([^]*)$/.exec(text) ?? [];
    if (name) types.set(plainType(name), fieldsOf(fields));
  }
  return types;
}

// Bytes are those of the definition's lines without comments; a constant is not a field.
function fieldsOf(text) {
  const lines = text.split("\n").map((line) => line.replace(/#.*/, "").trim());
  const fields = lines.filter((line) => line && !line.includes("=")).map(fieldOf);
  if (fields.length > MAX_FIELDS) throw new CdrError("a type with too many fields");
  return fields.length ? fields : EMPTY;
}

function fieldOf(line) {
  const [, type, length, name] = FIELD.exec(line) ?? [];
  if (!type) throw new CdrError("a line that is not a field");
  return { name, type: plainType(type), length: length === undefined ? null : Number(length) };
}

class Reader {
  constructor(data, types) {
    this.data = data;
    this.view = new DataView(data.buffer, data.byteOffset, data.byteLength);
    this.types = types;
    this.at = 0;
    this.values = 0;
  }

  struct(name, depth) {
    const fields = this.types.get(name);
    if (!fields || depth > MAX_DEPTH) throw new CdrError("a type that is not known, or a part of itself");
    const value = Object.create(null); // a field may have any name
    for (const { name: field, type, length } of fields)
      value[field] = length === null ? this.one(type, depth) : this.many(type, length, depth);
    return value;
  }

  one(type, depth) {
    if (++this.values > MAX_VALUES) throw new CdrError("a message with too many values");
    if (Object.hasOwn(NUMBERS, type)) return this.number(type);
    return type === "string" ? this.string() : this.struct(type, depth + 1);
  }

  // Each value takes a byte at least. Bytes stay where they are: maps have millions.
  many(type, length, depth) {
    const count = length || this.number("uint32");
    const [size] = Object.hasOwn(NUMBERS, type) ? NUMBERS[type] : [1];
    if (count * size > this.data.length - this.at) throw new CdrError("a sequence that is longer than its message");
    if (BYTES.includes(type)) return this.bytes(count);
    if (type === "int8") return new Int8Array(this.bytes(count));
    const values = [];
    for (let i = 0; i < count; i++) values.push(this.one(type, depth));
    return values;
  }

  number(type) {
    const [size, read] = NUMBERS[type];
    this.at += -this.at & (size - 1);
    const at = this.take(size);
    return read(this.view, at);
  }

  string() {
    const length = this.number("uint32");
    return new TextDecoder().decode(this.bytes(length).subarray(0, Math.max(0, length - 1)));
  }

  bytes(count) {
    const at = this.take(count);
    return this.data.subarray(at, at + count);
  }

  take(size) {
    const at = this.at;
    if (at + size > this.data.length) throw new CdrError("a message that is cut");
    this.at += size;
    return at;
  }
}
