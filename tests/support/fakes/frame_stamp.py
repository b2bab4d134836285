"""Reads the timestamp that a simulated camera has drawn into its frame.

`read_stamp` takes a JPEG, a screenshot of the picture alone or any other image file; `READ_STAMP` is the same in a
page's own JavaScript, for an <img>, <canvas> or <video>, so that the age of what is on the screen is known without a
screenshot. The two share with the drawing the layout alone, which images/sim_robot/sim_robot/camera.py describes.
"""

from __future__ import annotations

import binascii
import io

from PIL import Image

COLUMNS, ROWS, ROW_PART = 32, 2, 1 / 40
STAMP_BYTES = 6


class NoStampError(Exception):
    pass


def read_stamp(data: bytes) -> float:
    """Unix time in seconds of the moment that the picture shows; NoStampError if it cannot be read."""
    with Image.open(io.BytesIO(data)) as opened:
        return stamp_of(opened)


def stamp_of(image: Image.Image) -> float:
    grey = image.convert("L")
    cells = [_cell(grey, row, column) for row in range(ROWS) for column in range(COLUMNS)]
    number = int("".join("1" if cell > 127 else "0" for cell in cells), 2)
    whole = number.to_bytes(STAMP_BYTES + 2, "big")
    stamp, check = whole[:STAMP_BYTES], whole[STAMP_BYTES:]
    if binascii.crc_hqx(stamp, 0xFFFF) != int.from_bytes(check, "big"):
        raise NoStampError(f"cannot read the stamp of a picture of {grey.size}: {whole.hex()}")
    return int.from_bytes(stamp, "big") / 10_000


def _cell(grey: Image.Image, row: int, column: int) -> float:
    width, height = grey.size
    left, top = width * column / COLUMNS, height * (1 - (ROWS - row) * ROW_PART)
    across, down = width / COLUMNS, height * ROW_PART
    inner = (left + across / 4, top + down / 4, left + across * 3 / 4, top + down * 3 / 4)
    brightness = grey.resize((1, 1), Image.Resampling.BOX, box=inner).getpixel((0, 0))
    assert isinstance(brightness, int | float)
    return brightness


# A function of the element: Unix time in ms of what it shows, or null.
READ_STAMP = """(() => {
  const COLUMNS = 32, ROWS = 2, PART = 1 / 40;
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [COLUMNS * 4, ROWS * 4];
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  const crc = (bytes) => bytes.reduce((sum, byte) => {
    sum ^= byte << 8;
    for (let i = 0; i < 8; i += 1) sum = sum & 0x8000 ? ((sum << 1) ^ 0x1021) & 0xffff : (sum << 1) & 0xffff;
    return sum;
  }, 0xffff);
  return (element) => {
    const width = element.naturalWidth || element.videoWidth || element.width;
    const height = element.naturalHeight || element.videoHeight || element.height;
    if (!width || !height) return null;
    pen.clearRect(0, 0, canvas.width, canvas.height);
    const strip = height * ROWS * PART;
    pen.drawImage(element, 0, height - strip, width, strip, 0, 0, canvas.width, canvas.height);
    const { data } = pen.getImageData(0, 0, canvas.width, canvas.height);
    const bytes = [0, 0, 0, 0, 0, 0, 0, 0];
    for (let bit = 0; bit < 64; bit += 1) {
      const [x, y] = [(bit % COLUMNS) * 4 + 1, Math.floor(bit / COLUMNS) * 4 + 1];
      const at = (dx, dy) => data[((y + dy) * canvas.width + x + dx) * 4];
      const bright = at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1) > 510;
      if (bright) bytes[bit >> 3] |= 0x80 >> (bit & 7);
    }
    if (crc(bytes.slice(0, 6)) !== bytes[6] * 256 + bytes[7]) return null;
    return bytes.slice(0, 6).reduce((sum, byte) => sum * 256 + byte, 0) / 10;
  };
})()"""
