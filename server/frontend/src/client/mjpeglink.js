// One multipart stream of JPEGs, for a robot whose agent has no frames protocol; the same outside as frameslink.js.
// A picture's moment is unknown there: it has that of its arrival.

import { MultipartReader, boundaryOf } from "../multipart.js";
import { plainQuery } from "./addresses.js";

const SILENCE_MS = 6000;
const WATCH_MS = 1000;

// The stream that belongs to an address of the frames protocol.
export function streamUrl(framesUrl, { quality_max: quality, width, height }) {
  const url = new URL(framesUrl);
  url.protocol = url.protocol.replace("ws", "http");
  url.pathname = url.pathname.replace(/frames$/, "stream");
  url.searchParams.set("type", "mjpeg");
  if (quality) url.searchParams.set("quality", quality);
  if (width && height) {
    url.searchParams.set("width", width);
    url.searchParams.set("height", height);
  }
  url.search = plainQuery(url.searchParams);
  return url.href;
}

export class MjpegLink {
  // `onEnd({status, code, opened})`: the HTTP status, 0 for none, and the server's own short code.
  constructor(url, { onFrame, onStatus, onEnd, now }) {
    Object.assign(this, { onFrame, onStatus, onEnd, now });
    this.number = 0;
    this.newest = null; // waits while the one before is being shown
    this.abort = new AbortController();
    this.heardAt = now();
    this.timer = setInterval(() => this.watch(), WATCH_MS);
    this.run(url);
  }

  want() {} // the stream is as it was asked for

  watch() {
    if (this.now() - this.heardAt > SILENCE_MS) this.end({ status: 0 });
  }

  async run(url) {
    try {
      const answer = await fetch(url, { signal: this.abort.signal, cache: "no-store" });
      if (!answer.ok) return this.end(await refusal(answer));
      const boundary = boundaryOf(answer.headers.get("Content-Type"));
      if (boundary === null) return this.end({ status: 502, code: "video_down" });
      await this.read(answer.body.getReader(), new MultipartReader(boundary));
    } catch {
      // a cut, told below
    }
    this.end({ status: 0 });
  }

  async read(body, reader) {
    for (let read = await body.read(); !read.done; read = await body.read()) {
      this.heardAt = this.now();
      const jpeg = reader.push(read.value).at(-1);
      if (jpeg && this.onEnd) this.take(jpeg);
    }
  }

  // Reading goes on while a picture is shown: what waits in the network would look new when it comes.
  take(jpeg) {
    this.number += 1;
    this.newest = { jpeg, number: this.number, at: this.now(), quality: 0, byCamera: false, bytes: jpeg.length };
    this.onStatus({ state: "live", source: "mjpeg" });
    this.showing ??= this.showAll();
  }

  // A picture that cannot be decoded is one that is skipped.
  async showAll() {
    while (this.newest && this.onEnd) {
      const frame = this.newest;
      this.newest = null;
      await Promise.resolve(this.onFrame(frame)).catch(() => {});
    }
    this.showing = null;
  }

  close() {
    this.onEnd = null;
    clearInterval(this.timer);
    this.abort.abort();
  }

  end(how) {
    const { onEnd } = this;
    if (!onEnd) return;
    this.close();
    onEnd({ ...how, opened: this.number > 0 });
  }
}

async function refusal(answer) {
  const { code = "" } = await answer.json().catch(() => ({}));
  return { status: answer.status, code };
}
