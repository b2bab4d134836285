// Reads a recording by its index: which topics it has and when, and the messages of some of them. A robot may have written what is in
// it, so a part that cannot be read is left out and counted, and times that are none of a recording are not shown.

import { McapConstants, McapIndexedReader } from "@mcap/core";
import { CdrError, decoderOf } from "./cdr.js";
import { RangeFileError } from "./rangeFile.js";
import { readableOf } from "./incompleteFile.js";

/**
 * @typedef {{channelId: number, topic: string, atMs: number, ageMs: number, data: Uint8Array}} RecordedMessage
 *   `atMs` from the recording's beginning on; `ageMs` how much earlier it was published, as the recorder has it
 * @typedef {{fromMs: number, toMs: number}} Span
 */

const MAX_SPAN_MS = 24 * 3600_000; // a recording has four hours at most
const MAX_TOPICS = 500;
const MAX_DAMAGES = 20; // of a file, after which reading ends
const GAP_MS = 1500; // least time without a message that is a gap; the recorder ends a chunk each half second
const MS_PER_NS = 1e-6;

export class RecordingReader {
  // `file` as of rangeFile.js, which is open. Throws what it throws, and Error for what is not a recording.
  static async open(file) {
    const isWhole = await hasEnd(file);
    const { readable, isCut } = isWhole ? { readable: file, isCut: false } : await readableOf(file);
    const mcap = await McapIndexedReader.Initialize({ readable });
    return new RecordingReader(mcap, { isWhole, isCut });
  }

  // `isWhole`: its recorder has ended it. `isCut`: not all of what is there was searched.
  constructor(mcap, { isWhole, isCut }) {
    this.mcap = mcap;
    this.isWhole = isWhole;
    this.isCut = isCut;
    const chunks = mcap.chunkIndexes.filter(({ messageIndexOffsets }) => messageIndexOffsets.size);
    this.startNs = chunks[0]?.messageStartTime ?? 0n;
    const spans = chunks.map((chunk) => ({ chunk, fromMs: this.ms(chunk.messageStartTime), toMs: this.ms(chunk.messageEndTime) }));
    this.chunks = spans.filter(({ fromMs, toMs }) => fromMs >= 0 && toMs >= fromMs && toMs <= MAX_SPAN_MS);
    this.chunks.sort((a, b) => a.fromMs - b.fromMs);
    this.left = spans.length - this.chunks.length; // chunks with times that are none of a recording
    this.durationMs = this.chunks.reduce((last, { toMs }) => Math.max(last, toMs), 0);
    this.topics = [...mcap.channelsById.values()].slice(0, MAX_TOPICS).map(({ topic, schemaId }) => ({
      name: topic,
      type: mcap.schemasById.get(schemaId)?.name ?? "",
    }));
    this.decoders = new Map();
    this.unreadable = 0;
    this.damages = 0;
  }

  ms(ns) {
    return Number(ns - this.startNs) * MS_PER_NS;
  }

  ns(ms) {
    return this.startNs + BigInt(Math.round(ms / MS_PER_NS));
  }

  // When there are messages of one of these topics, to half a second; of any without them.
  /** @param {string[]} [topics] @returns {Span[]} */
  spans(topics) {
    const channels = topics && [...this.mcap.channelsById.values()].filter(({ topic }) => topics.includes(topic)).map(({ id }) => id);
    /** @type {Span[]} */
    const spans = [];
    for (const { chunk, fromMs, toMs } of this.chunks) {
      if (channels && !channels.some((id) => chunk.messageIndexOffsets.has(id))) continue;
      const last = spans.at(-1);
      if (last && fromMs - last.toMs <= GAP_MS) last.toMs = Math.max(last.toMs, toMs);
      else spans.push({ fromMs, toMs });
    }
    return spans;
  }

  // In the order of their times, after `afterMs` and up to `toMs`. What is damaged is left out.
  /** @returns {AsyncGenerator<RecordedMessage, void, void>} */
  async *messages({ topics, afterMs = -1, toMs = this.durationMs }) {
    let after = afterMs;
    while (after < toMs && this.damages < MAX_DAMAGES) {
      try {
        for await (const message of this.raw({ topics, fromMs: after + MS_PER_NS, toMs })) {
          yield message;
          after = message.atMs - MS_PER_NS; // another may have the same time
        }
        return;
      } catch (error) {
        this.noteDamage(error);
        after = this.chunkEnd(after) ?? toMs;
      }
    }
  }

  // Where the first chunk ends that has something after that time.
  chunkEnd(atMs) {
    return this.chunks.find(({ toMs }) => toMs > atMs)?.toMs;
  }

  noteDamage(error) {
    if (error instanceof RangeFileError) throw error;
    this.damages += 1;
  }

  // The newest first; nothing more after what is damaged.
  /** @returns {AsyncGenerator<RecordedMessage, void, void>} */
  async *backwards({ topics, fromMs = 0, toMs }) {
    try {
      yield* this.raw({ topics, fromMs, toMs, reverse: true });
    } catch (error) {
      this.noteDamage(error);
    }
  }

  async *raw({ topics, fromMs, toMs, reverse = false }) {
    const range = { startTime: this.ns(Math.max(fromMs, 0)), endTime: this.ns(toMs) };
    for await (const { channelId, logTime, publishTime, data } of this.mcap.readMessages({ topics, ...range, reverse })) {
      const topic = this.mcap.channelsById.get(channelId)?.topic ?? "";
      yield { channelId, topic, atMs: this.ms(logTime), ageMs: Number(logTime - publishTime) * MS_PER_NS, data };
    }
  }

  // A message as rosbridge would give it; null for what is none of its type, which is counted.
  decode({ channelId, data }) {
    try {
      return this.decoder(channelId)(data);
    } catch (error) {
      if (!(error instanceof CdrError)) throw error;
      this.unreadable += 1;
      return null;
    }
  }

  decoder(channelId) {
    const kept = this.decoders.get(channelId);
    if (kept) return kept;
    const channel = this.mcap.channelsById.get(channelId);
    const schema = this.mcap.schemasById.get(channel?.schemaId ?? 0);
    if (schema?.encoding !== "ros2msg" || channel?.messageEncoding !== "cdr") throw new CdrError("a message without a definition");
    const decoder = decoderOf(schema.name, new TextDecoder().decode(schema.data));
    this.decoders.set(channelId, decoder);
    return decoder;
  }
}

async function hasEnd(file) {
  const magic = McapConstants.MCAP_MAGIC;
  const end = await file.slice(Math.max(0, file.bytes - magic.length), Math.min(file.bytes, magic.length));
  return end.length === magic.length && magic.every((byte, i) => end[i] === byte);
}
