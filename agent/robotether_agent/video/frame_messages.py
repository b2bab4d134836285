"""The frames protocol's messages (docs/reference/media.md) as a sender reads and writes them.

A broken text names its field; an unknown `op` is nothing, so that the other side may be newer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from robotether_common.codecs import JPEG, Codec, decoded_by
from robotether_common.frames import (
    FPS,
    HEADER,
    KEY,
    LATENCIES_MS,
    MAX_CREDITS,
    PREFERENCES,
    QUALITIES,
    SEQUENCES,
    SIDES,
    STAMPED,
    StreamRequest,
)

from robotether_agent.fields import (
    FieldError,
    JsonObject,
    get_flag,
    get_int,
    get_number,
    get_text,
    parse_object,
)

# Maximum clock of a browser in ms, so that a sum never loses its fractions.
MAX_CLOCK_MS = 1e13

Getter = Callable[[JsonObject, str, Any, Any], Any]


@dataclass(frozen=True)
class Header:
    """What a frame's header says; `timestamp_ms` is on the sender's clock, `quality` 0 is unknown."""

    sequence: int
    timestamp_ms: float
    quality: int = 0
    is_stamped: bool = False
    codec: Codec = JPEG
    # Of a codec that depends on earlier frames: it can be shown without them.
    is_key: bool = False

    def packed(self) -> bytes:
        """Return the header as it is on the wire."""
        flags = (STAMPED if self.is_stamped else 0) | (KEY if self.is_key else 0)
        return HEADER.pack(
            self.codec.number, flags, self.quality, self.sequence % SEQUENCES, self.timestamp_ms
        )


@dataclass(frozen=True)
class Credit:
    """A grant of `frames` more frames; `taken` is the number of the newest that has arrived."""

    frames: int
    taken: int | None


@dataclass(frozen=True)
class ClockSync:
    """Asks for the clock; `t_ms` goes back as it came."""

    t_ms: float


@dataclass(frozen=True)
class KeyFrameRequest:
    """Says that the receiver cannot decode before a key frame."""


Request = StreamRequest | Credit | ClockSync | KeyFrameRequest


def parse(text: bytes | str) -> Request | None:
    """Return what a text asks, or nothing for an unknown `op`; FieldError for a broken one."""
    message = parse_object(text, "the text")
    reader = READERS.get(get_text(message, "op", limit=50))
    return None if reader is None else reader(message)


def _stream_request(message: JsonObject) -> StreamRequest:
    prefers: Any = message.get("prefers")
    request = StreamRequest(
        quality_min=_or(message, "quality_min", StreamRequest.quality_min, get_int, of=QUALITIES),
        quality_max=_or(message, "quality_max", StreamRequest.quality_max, get_int, of=QUALITIES),
        fps=_or(message, "fps", StreamRequest.fps, get_number, of=FPS),
        latency_ms=_or(
            message, "latency_ms", StreamRequest.latency_ms, get_number, of=LATENCIES_MS
        ),
        width=_or(message, "width", None, get_int, of=SIDES),
        height=_or(message, "height", None, get_int, of=SIDES),
        codecs=decoded_by(message.get("codecs")),
        prefers=prefers if prefers in PREFERENCES else None,
        yields=get_flag(message, "yields", default=False),
    )
    if request.quality_min > request.quality_max:
        raise FieldError("field quality_min must not be over quality_max")
    if (request.width is None) != (request.height is None):
        raise FieldError("fields width and height must be both there, or none")
    return request


def _credit(message: JsonObject) -> Credit:
    frames = _or(message, "frames", 1, get_int, of=(0, 2**31))
    return Credit(
        min(frames, MAX_CREDITS), _or(message, "taken", None, get_int, of=(0, SEQUENCES - 1))
    )


def _or(message: JsonObject, name: str, default: Any, get: Getter, *, of: tuple[Any, Any]) -> Any:
    """Return the field, within the bounds `of`, or its default where it is missing or null."""
    return default if message.get(name) is None else get(message, name, *of)


READERS: dict[str, Callable[[JsonObject], Request]] = {
    "stream_request": _stream_request,
    "credit": _credit,
    "clock_sync": lambda message: ClockSync(
        get_number(message, "t_ms", -MAX_CLOCK_MS, MAX_CLOCK_MS)
    ),
    "key_frame": lambda _: KeyFrameRequest(),
}
