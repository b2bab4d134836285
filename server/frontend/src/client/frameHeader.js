// Takes a picture of the frames protocol (docs/media.md) apart. Pure.

const LENGTH = 16; // Python's struct: !BBHId
const JPEG = 1;
const CAMERA_STAMP = 1;

// Gives {number, quality, byCamera, timestampMs, jpeg}, the moment by the sender's clock; null for what this page
// cannot show, such as a codec of a newer server. Nothing is copied: `jpeg` is a view of `data`.
export function readFrame(data) {
  if (data.byteLength <= LENGTH) return null;
  const view = new DataView(data);
  const timestampMs = view.getFloat64(8);
  if (view.getUint8(0) !== JPEG || !Number.isFinite(timestampMs)) return null;
  return {
    number: view.getUint32(4),
    quality: view.getUint16(2),
    byCamera: Boolean(view.getUint8(1) & CAMERA_STAMP),
    timestampMs,
    jpeg: new Uint8Array(data, LENGTH),
  };
}
