// Takes the JPEG frames out of a multipart/x-mixed-replace body (MJPEG over HTTP) as its bytes arrive. Pure.

const LIMIT = 10 * 1024 * 1024;
const HEADER_LIMIT = 8 * 1024;
const HEADER_END = [13, 10, 13, 10];

export class MultipartReader {
  constructor(boundary) {
    this.delimiter = [...`\r\n--${boundary}`].map((char) => char.charCodeAt(0));
    this.buffer = new Uint8Array(0);
  }

  // Gives the frames (Uint8Array) that these bytes complete. Throws for a body that is no such stream.
  push(bytes) {
    this.buffer = join(this.buffer, bytes);
    const frames = [];
    for (let frame = this.next(); frame; frame = this.next()) frames.push(frame);
    if (this.buffer.length > LIMIT) throw new Error("cannot read the video: a frame is over 10 MB");
    return frames;
  }

  next() {
    const headerEnd = indexOf(this.buffer, HEADER_END, 0);
    if (headerEnd < 0) return this.checkHeader();
    const start = headerEnd + HEADER_END.length;
    const length = contentLength(this.buffer.subarray(0, headerEnd));
    const end = length === null ? indexOf(this.buffer, this.delimiter, start) : start + length;
    if (end < 0 || end > this.buffer.length) return null;
    const frame = this.buffer.slice(start, end);
    this.buffer = this.buffer.slice(end);
    return frame;
  }

  checkHeader() {
    if (this.buffer.length > HEADER_LIMIT) {
      throw new Error("cannot read the video: the answer is no multipart stream");
    }
    return null;
  }
}

// The boundary in a Content-Type, or null when that type is no multipart stream.
export function boundaryOf(contentType) {
  const match = /^multipart\/x-mixed-replace\s*;.*?boundary="?([^";]+)/i.exec(contentType || "");
  return match && match[1].replace(/^--/, "");
}

function contentLength(header) {
  const match = /^content-length:\s*(\d+)/im.exec(String.fromCharCode(...header));
  return match && Number(match[1]);
}

function join(a, b) {
  if (a.length === 0) return b;
  const all = new Uint8Array(a.length + b.length);
  all.set(a);
  all.set(b, a.length);
  return all;
}

function indexOf(bytes, pattern, from) {
  for (let i = bytes.indexOf(pattern[0], from); i >= 0; i = bytes.indexOf(pattern[0], i + 1)) {
    if (pattern.every((byte, j) => bytes[i + j] === byte)) return i;
  }
  return -1;
}
