// Reads a JPEG's size before the browser decodes it (ITU-T T.81, annex B): robots make these, and a few bytes may claim gigabytes.
// Pure.

const MAX_PIXELS = 2 ** 26; // 256 MB when decoded
const START = 0xffd8; // of an image
const NO_MARKERS = [0x00, 0xff]; // after 0xff
const TABLES = [0xc4, 0xc8, 0xcc]; // among the markers with which a frame begins
const ENDS = [0xd8, 0xd9, 0xda]; // before which a frame would have begun

// The blob of a JPEG; throws for what is none, or what nobody should decode.
export function jpegBlob(data) {
  const size = jpegSize(data);
  if (!size) throw new Error("cannot show a frame: it is not a JPEG");
  const { width, height } = size;
  if (width * height > MAX_PIXELS) throw new Error(`cannot show a frame of ${width}x${height}: it has too many pixels`);
  return new Blob([data], { type: "image/jpeg" });
}

// {width, height} as browsers find them; null for what is not a JPEG.
export function jpegSize(data) {
  const number = (at) => (data[at] << 8) | data[at + 1];
  if (number(0) !== START) return null;
  for (let at = nextMarker(data, 2); at + 8 < data.length; at = nextMarker(data, at)) {
    const marker = data[at + 1];
    if (isFrame(marker)) return { width: number(at + 7), height: number(at + 5) };
    if (ENDS.includes(marker)) return null;
    at += isAlone(marker) ? 2 : 2 + Math.max(2, number(at + 2));
  }
  return null;
}

// Browsers skip what is none.
function nextMarker(data, from) {
  let at = from;
  while (at < data.length && (data[at] !== 0xff || NO_MARKERS.includes(data[at + 1]))) at += 1;
  return at;
}

const isFrame = (marker) => marker >= 0xc0 && marker <= 0xcf && !TABLES.includes(marker);
const isAlone = (marker) => marker === 0x01 || (marker >= 0xd0 && marker <= 0xd7);
