// Reads pieces of a recording's file from the server by HTTP ranges, and keeps some of them. It must never load the whole file.

const BLOCK_BYTES = 512 * 1024;
const MAX_BLOCKS = 48;
const MAX_READ_BYTES = 32 * 1024 * 1024;
const MAX_ATTEMPTS = 4;
const AGAIN_MS = 500; // delay before the second attempt, doubled for each further one
const BUSY = [0, 429, 502, 503, 504]; // 0: no answer

export class RangeFileError extends Error {
  // `status` 0 is no answer; `detail` is the server's own sentence.
  constructor(status, detail = "") {
    super(`cannot read the recording: ${detail || (status ? `the server answered ${status}` : "no answer")}`);
    this.status = status;
    this.detail = detail;
  }
}

// What a file says of itself does not fit.
export class BrokenFileError extends Error {}

export class RangeFile {
  /** @param {string} url @param {{load?: typeof fetch, wait?: (ms: number) => Promise<void>}} options */
  constructor(url, { load = (...args) => fetch(...args), wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms)) } = {}) {
    this.url = url;
    this.load = load;
    this.wait = wait;
    this.bytes = 0; // size of the file when it was opened
    /** @type {Map<number, Promise<Uint8Array>>} */
    this.blocks = new Map(); // the one that was used last comes last
  }

  async open() {
    const first = this.block(0);
    await first;
    return this;
  }

  // As of IReadable of @mcap/core.
  async size() {
    return BigInt(this.bytes);
  }

  /** @param {bigint} offset @param {bigint} size */
  async read(offset, size) {
    return this.slice(Number(offset), Number(size));
  }

  // Through the blocks that are kept. What is asked for may be what a broken file says.
  async slice(from, length) {
    this.check(from, length);
    const [first, last] = [Math.floor(from / BLOCK_BYTES), Math.floor((from + Math.max(length, 1) - 1) / BLOCK_BYTES)];
    const numbers = Array.from({ length: last - first + 1 }, (_, i) => first + i);
    const blocks = await Promise.all(numbers.map((number) => this.block(number)));
    this.readAhead(last + 1);
    const begin = from - first * BLOCK_BYTES;
    if (blocks.length === 1) return blocks[0].slice(begin, begin + length);
    const whole = new Uint8Array(blocks.reduce((sum, block) => sum + block.length, 0));
    blocks.reduce((at, block) => (whole.set(block, at), at + block.length), 0);
    return whole.slice(begin, begin + length);
  }

  // A small piece by itself, of which nothing is kept.
  async piece(from, length) {
    this.check(from, length);
    return length ? this.fetchBytes(from, from + length - 1) : new Uint8Array();
  }

  check(from, length) {
    const fits = Number.isSafeInteger(from) && from >= 0 && length >= 0 && from + length <= this.bytes;
    if (!fits || length > MAX_READ_BYTES) throw new BrokenFileError("a part of the recording is not where the file says, or too large");
  }

  block(number) {
    const kept = this.blocks.get(number);
    const block = kept ?? this.fetchBlock(number);
    this.blocks.delete(number);
    this.blocks.set(number, block);
    for (const oldest of this.blocks.keys()) {
      if (this.blocks.size <= MAX_BLOCKS) break;
      this.blocks.delete(oldest);
    }
    return block;
  }

  fetchBlock(number) {
    const from = number * BLOCK_BYTES;
    const to = this.bytes ? Math.min(from + BLOCK_BYTES, this.bytes) : BLOCK_BYTES;
    const block = this.fetchBytes(from, to - 1);
    block.catch(() => this.blocks.delete(number));
    return block;
  }

  readAhead(number) {
    if (number * BLOCK_BYTES < this.bytes && !this.blocks.has(number)) this.block(number).catch(() => {});
  }

  async fetchBytes(first, last) {
    for (let attempt = 1; ; attempt++) {
      try {
        return await this.fetchOnce(first, last);
      } catch (error) {
        if (attempt === MAX_ATTEMPTS || !(error instanceof RangeFileError) || !BUSY.includes(error.status)) throw error;
        await this.wait(AGAIN_MS * 2 ** (attempt - 1));
      }
    }
  }

  // A log-in that has ended is a redirect. An answer without a range would be the whole file.
  async fetchOnce(first, last) {
    const headers = { Range: `bytes=${first}-${last}` };
    const answer = await this.load(this.url, { headers, redirect: "manual", cache: "no-store" }).catch(() => null);
    if (!answer) throw new RangeFileError(0);
    if (answer.type === "opaqueredirect") throw new RangeFileError(401);
    const total = totalOf(answer);
    if (answer.status !== 206 || !total) throw await refusalOf(answer);
    this.bytes ||= total;
    const buffer = await answer.arrayBuffer().catch(() => null);
    if (buffer?.byteLength !== Math.min(last + 1, this.bytes) - first) throw new RangeFileError(0);
    return new Uint8Array(/** @type {ArrayBuffer} */ (buffer));
  }
}

const totalOf = (answer) => Number(/^bytes \d+-\d+\/(\d+)$/.exec(answer.headers.get("Content-Range") ?? "")?.[1] ?? 0);

async function refusalOf(answer) {
  const isProblem = answer.headers.get("Content-Type")?.includes("json");
  const { detail = "" } = isProblem ? ((await answer.json().catch(() => null)) ?? {}) : {};
  answer.body?.cancel?.().catch(() => {});
  return new RangeFileError(answer.status, detail);
}
