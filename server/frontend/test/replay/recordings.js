// Files as the recorder writes them, and a server that sends pieces of them.

import { McapWriter } from "@mcap/core";

const BEGAN_NS = 1_700_000_000_000_000_000n;
export const ns = (ms) => BEGAN_NS + BigInt(Math.round(ms * 1e6));

const encoder = new TextEncoder();

// A std_msgs/String in CDR.
export function text(words) {
  const data = encoder.encode(`${words}\0`);
  const message = new Uint8Array(8 + data.length);
  message.set([0, 1, 0, 0]);
  new DataView(message.buffer).setUint32(4, data.length, true);
  message.set(data, 8);
  return message;
}

class Memory {
  parts = [];
  size = 0;
  position = () => BigInt(this.size);
  async write(bytes) {
    this.parts.push(bytes.slice());
    this.size += bytes.length;
  }
}

// `messages` are {topic, atMs, data, logNs}, each in a chunk of its own. Gives the file's bytes, and where each message's chunk ends.
export async function recordingOf(messages, { definition = "string data\n" } = {}) {
  const file = new Memory();
  const writer = new McapWriter({ writable: file, chunkSize: 1 });
  await writer.start({ profile: "ros2", library: "robotether" });
  const schemaId = await writer.registerSchema({ name: "std_msgs/msg/String", encoding: "ros2msg", data: encoder.encode(definition) });
  const channels = new Map();
  for (const topic of new Set(messages.map((message) => message.topic))) {
    channels.set(topic, await writer.registerChannel({ schemaId, topic, messageEncoding: "cdr", metadata: new Map() }));
  }
  const ends = [];
  for (const { topic, atMs, data = text(String(atMs)), logNs = ns(atMs) } of messages) {
    await writer.addMessage({ channelId: channels.get(topic), sequence: 0, logTime: logNs, publishTime: logNs, data });
    ends.push(file.size);
  }
  await writer.end();
  return { bytes: Buffer.concat(file.parts), ends };
}

// As nginx sends a file; `asked` has the size of each piece. `answers` come before that.
export function serverOf(bytes, { answers = [] } = {}) {
  const asked = [];
  async function load(_url, { headers }) {
    const early = answers.shift();
    if (early) return early;
    const [first, last] = headers.Range.match(/\d+/g).map(Number);
    const piece = bytes.subarray(first, last + 1);
    asked.push(piece.length);
    return new Response(piece, { status: 206, headers: { "Content-Range": `bytes ${first}-${first + piece.length - 1}/${bytes.length}` } });
  }
  return { load, asked };
}
