"""What an access unit of H.264 in Annex B says of itself, without decoding it (ITU-T H.264, 7.3 and B.1). Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

START_CODE = b"\0\0\1"
SLICE, IDR_SLICE, SPS, PPS = 1, 5, 7, 8
B_SLICES = (1, 6)
# Size of what is read of a slice: its type stands first.
HEADER_BYTES = 16
# Maximum number of NAL units that are read, with which a frame begins: 10 MB of start codes take a second or more.
MAX_UNITS = 64


@dataclass(frozen=True)
class AccessUnit:
    """One frame: `is_key` can be decoded without those before it, `is_complete` with what it contains itself."""

    has_slice: bool
    is_key: bool
    is_complete: bool
    is_bidirectional: bool


def access_unit(data: bytes) -> AccessUnit | None:
    """Return what a frame is; nothing for data that is not in Annex B."""
    types: set[int] = set()
    is_bidirectional = False
    for at in islice(_units(data), MAX_UNITS):
        kind = data[at] & 31
        if kind in (SLICE, IDR_SLICE) and not {SLICE, IDR_SLICE} & types:
            is_bidirectional = _slice_type(data[at + 1 : at + 1 + HEADER_BYTES]) in B_SLICES
        types.add(kind)
    if not types or not data.startswith((START_CODE, b"\0" + START_CODE)):
        return None
    return AccessUnit(
        has_slice=bool({SLICE, IDR_SLICE} & types),
        is_key=IDR_SLICE in types,
        is_complete={SPS, PPS} <= types,
        is_bidirectional=is_bidirectional,
    )


def _units(data: bytes) -> Iterator[int]:
    """Yield where each NAL unit begins, after its start code."""
    at = data.find(START_CODE)
    while 0 <= at < len(data) - len(START_CODE):
        yield at + len(START_CODE)
        at = data.find(START_CODE, at + len(START_CODE))


def _slice_type(header: bytes) -> int:
    """Return the slice's type, which follows the number of its first macroblock."""
    bits = "".join(f"{byte:08b}" for byte in header.replace(b"\0\0\3", b"\0\0"))
    _, bits = _number(bits)
    return _number(bits)[0]


def _number(bits: str) -> tuple[int, str]:
    """Return a number in Exp-Golomb code, and what follows it; 0 where the bits end before."""
    zeros = len(bits) - len(bits.lstrip("0"))
    end = 2 * zeros + 1
    return (int(bits[zeros:end], 2) - 1 if end <= len(bits) else 0), bits[end:]
