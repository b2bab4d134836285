// A recording that has no index yet: one that goes on, or whose recorder was killed. What is whole of it is found by the heads of its
// chunks, and looks like a file whose end comes behind them.

import { McapConstants, McapRecordBuilder } from "@mcap/core";

const MAGIC_BYTES = 8;
const HEAD_BYTES = 9; // opcode and length of a record
const CHUNK_HEAD_BYTES = HEAD_BYTES + 40; // and what comes before a chunk's records, without compression
const INDEX_HEAD_BYTES = HEAD_BYTES + 2; // and the channel's number
const WINDOW_BYTES = 16 * 1024;
const MAX_CHUNKS = 40_000; // more than in the longest recording
const SEARCH_MS = 20_000; // time limit for the search
const { Opcode } = McapConstants;

// `file` as of rangeFile.js. Gives {readable, isCut}: what McapIndexedReader reads, and whether the search ended for its time.
export async function readableOf(file) {
  const search = new Search(file);
  const isCut = await search.run();
  const tail = search.tail();
  const end = BigInt(search.end);
  const readable = {
    size: async () => end + BigInt(tail.length),
    read: async (offset, size) =>
      offset >= end ? tail.subarray(Number(offset - end), Number(offset - end + size)) : file.read(offset, size),
  };
  return { readable, isCut };
}

class Search {
  constructor(file) {
    this.file = file;
    this.end = MAGIC_BYTES; // up to here the file is whole
    this.known = new Set(); // channels whose records are kept
    this.kept = []; // records of schemas and channels, as they are in the file
    this.chunks = [];
    this.window = { from: 0, bytes: new Uint8Array() };
  }

  // Says whether it took too long.
  async run() {
    const begun = performance.now();
    this.end += await this.recordBytes(this.end);
    while (await this.chunk()) {
      if (this.chunks.length >= MAX_CHUNKS || performance.now() - begun > SEARCH_MS) return true;
    }
    return false;
  }

  // Takes over the chunk at the end; says whether there is one, as a whole, with what lists its messages.
  async chunk() {
    const start = this.end;
    const head = await this.view(start, CHUNK_HEAD_BYTES);
    if (!head || head.getUint8(0) !== Opcode.CHUNK) return false;
    const length = HEAD_BYTES + Number(head.getBigUint64(1, true));
    const [begins, ends, size] = [9, 17, 25].map((at) => head.getBigUint64(at, true));
    const isPlain = head.getUint32(37, true) === 0 && BigInt(length - CHUNK_HEAD_BYTES) === size;
    if (!isPlain || start + length > this.file.bytes) return false;
    const { messageIndexOffsets, end } = await this.indexes(start + length);
    if (end > this.file.bytes) return false;
    if ([...messageIndexOffsets.keys()].some((channel) => !this.known.has(channel))) await this.keep(start, length);
    this.chunks.push({
      messageStartTime: begins,
      messageEndTime: ends,
      chunkStartOffset: BigInt(start),
      chunkLength: BigInt(length),
      messageIndexOffsets,
      messageIndexLength: BigInt(end - start - length),
      compression: "",
      compressedSize: size,
      uncompressedSize: size,
    });
    this.end = end;
    return true;
  }

  // What lists a chunk's messages, from there on: where that of each channel is, and where the last ends.
  async indexes(from) {
    const messageIndexOffsets = new Map();
    let end = from;
    for (let record = await this.view(end, INDEX_HEAD_BYTES); record?.getUint8(0) === Opcode.MESSAGE_INDEX;) {
      messageIndexOffsets.set(record.getUint16(HEAD_BYTES, true), BigInt(end));
      end += HEAD_BYTES + Number(record.getBigUint64(1, true));
      record = await this.view(end, INDEX_HEAD_BYTES);
    }
    return { messageIndexOffsets, end };
  }

  // A channel's record is in the chunk that has its first message.
  async keep(start, length) {
    const bytes = await this.file.slice(start, length);
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    for (let at = CHUNK_HEAD_BYTES; at + HEAD_BYTES <= length;) {
      const next = at + HEAD_BYTES + Number(view.getBigUint64(at + 1, true));
      if (next > length) return;
      const opcode = bytes[at];
      if (opcode === Opcode.SCHEMA || opcode === Opcode.CHANNEL) this.kept.push(bytes.slice(at, next));
      if (opcode === Opcode.CHANNEL) this.known.add(view.getUint16(at + HEAD_BYTES, true));
      at = next;
    }
  }

  async recordBytes(at) {
    const head = await this.view(at, HEAD_BYTES);
    return head ? HEAD_BYTES + Number(head.getBigUint64(1, true)) : 0;
  }

  // At least `length` bytes from there on; null where the file is shorter.
  async view(at, length) {
    if (at + length > this.file.bytes) return null;
    const { from, bytes } = this.window;
    if (at < from || at + length > from + bytes.length) {
      this.window = { from: at, bytes: await this.file.piece(at, Math.min(WINDOW_BYTES, this.file.bytes - at)) };
    }
    const { window } = this;
    return new DataView(window.bytes.buffer, window.bytes.byteOffset + at - window.from, length);
  }

  // What the recorder would write behind the chunks.
  tail() {
    const data = new McapRecordBuilder();
    data.writeDataEnd({ dataSectionCrc: 0 });
    const index = new McapRecordBuilder();
    for (const chunk of this.chunks) index.writeChunkIndex(chunk);
    const footer = new McapRecordBuilder();
    footer.writeFooter({ summaryStart: BigInt(this.end + data.length), summaryOffsetStart: 0n, summaryCrc: 0 });
    return joined([data.buffer, ...this.kept, index.buffer, footer.buffer, Uint8Array.from(McapConstants.MCAP_MAGIC)]);
  }
}

function joined(parts) {
  const whole = new Uint8Array(parts.reduce((sum, { length }) => sum + length, 0));
  parts.reduce((at, part) => (whole.set(part, at), at + part.length), 0);
  return whole;
}
