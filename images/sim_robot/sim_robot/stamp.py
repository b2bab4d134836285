"""The moment of a picture, drawn into the picture itself so that a machine can read it back at the other end.

Used by camera.py for each picture; tests/support/fakes/frame_stamp.py reads it. Two rows of 32 cells fill the lowest
twentieth of the picture, black for 0 and white for 1: 48 bits of Unix time in tenths of a millisecond, then CRC-16 of
those six bytes (CCITT, begun with 0xffff), the highest bit first, the upper row first. Cells are large and grey alone,
and found by parts of the picture's size and not by pixels: they outlive poor JPEG quality and half the size.
"""

import binascii

from PIL import Image

COLUMNS, ROWS = 32, 2
ROW_PART = 1 / 40  # of the picture's height
SMALLEST = (128, 96)
STAMP_BYTES = 6
_NS_A_TENTH_MS = 100_000
_CRC_BEGIN = 0xFFFF


def put(image: Image.Image, stamp_ns: int) -> None:
    """Draw the moment over the lower edge; a picture too small for it stays as it is."""
    width, height = image.size
    if width < SMALLEST[0] or height < SMALLEST[1]:
        return
    cells = Image.frombytes("L", (COLUMNS, ROWS), bytes(255 * bit for bit in bits(stamp_ns)))
    top = round(height * (1 - ROWS * ROW_PART))
    image.paste(cells.resize((width, height - top), Image.Resampling.NEAREST), (0, top))


def bits(stamp_ns: int) -> list[int]:
    """Give the 64 bits of a moment."""
    stamp = (stamp_ns // _NS_A_TENTH_MS).to_bytes(STAMP_BYTES, "big")
    whole = stamp + binascii.crc_hqx(stamp, _CRC_BEGIN).to_bytes(2, "big")
    return [byte >> place & 1 for byte in whole for place in range(7, -1, -1)]
