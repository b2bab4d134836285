// Reads a JPEG's size before the browser decodes it (ITU-T T.81, annex B): robots make these, and a few bytes may claim gigabytes.
// Pure.

const MAX_PIXELS = 2 ** 26; // 256 MB when decoded
const START = 0xffd8; // of an image
const NO_MARKERS = [0x00, 0xff]; // after 0xff
const TABLES = [0xc4, 0xc8, 0xcc]; // among the markers with which a frame begins
const ENDS = [0xd8, 0xd9, 0xda]; // before which a frame would have begun
const EXIF = 0xe1;

// The blob of a JPEG without Exif, by which a browser would turn it: nobody turns the same camera's frames in other codecs, and
// recorded ones. Throws for what is none, or what nobody should decode.
export function jpegBlob(data) {
  const size = jpegSize(data);
  if (!size) throw new Error("cannot show a frame: it is not a JPEG");
  const { width, height } = size;
  if (width * height > MAX_PIXELS) throw new Error(`cannot show a frame of ${width}x${height}: it has too many pixels`);
  return new Blob(withoutExif(data), { type: "image/jpeg" });
}

// {width, height} as browsers find them; null for what is not a JPEG.
export function jpegSize(data) {
  if (number(data, 0) !== START) return null;
  for (const { marker, at } of segmentsOf(data)) {
    if (isFrame(marker)) return { width: number(data, at + 7), height: number(data, at + 5) };
    if (ENDS.includes(marker)) return null;
  }
  return null;
}

// What is left of a JPEG, in parts.
function withoutExif(data) {
  const parts = [];
  let from = 0;
  for (const { marker, at, end } of segmentsOf(data)) {
    if (isFrame(marker)) break;
    if (marker !== EXIF) continue;
    parts.push(data.subarray(from, at));
    from = end;
  }
  return [...parts, data.subarray(from)];
}

const number = (data, at) => (data[at] << 8) | data[at + 1];

function* segmentsOf(data) {
  for (let at = nextMarker(data, 2); at + 8 < data.length;) {
    const marker = data[at + 1];
    const end = at + 2 + (isAlone(marker) ? 0 : Math.max(2, number(data, at + 2)));
    yield { marker, at, end };
    at = nextMarker(data, end);
  }
}

// Browsers skip what is none.
function nextMarker(data, from) {
  let at = from;
  while (at < data.length && (data[at] !== 0xff || NO_MARKERS.includes(data[at + 1]))) at += 1;
  return at;
}

const isFrame = (marker) => marker >= 0xc0 && marker <= 0xcf && !TABLES.includes(marker);
const isAlone = (marker) => marker === 0x01 || (marker >= 0xd0 && marker <= 0xd7);
