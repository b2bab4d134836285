"""The frames protocol in bytes and texts: frames, stream and key frame requests, credits, clock syncs and statuses.

docs/reference/media.md describes it. `feeds` and `feed_link` speak it with robots, `frames_handler` with viewers. A
frame is written once, with its WebSocket header, and all viewers get that one object: what a server sends has no
mask. Pure.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import inf
from typing import Any, TypeGuard, get_args

from robotether_common.codecs import CODECS, NAMES, decoded_by
from robotether_common.frames import (
    FPS,
    HEADER,
    KEY,
    LATENCIES_MS,
    MAX_DEPENDENT_FRAME_BYTES,
    MAX_FRAME_BYTES,
    MAX_SIDE,
    MAX_TEXT_BYTES,
    PREFERENCES,
    QUALITIES,
    SEQUENCES,
    SIDES,
    Source,
    State,
    StreamRequest,
    VideoStatus,
)

from robotether_server.problems import ProtocolError
from robotether_server.relay.http.sockets import WHOLE_BINARY, WHOLE_TEXT, websocket_header
from robotether_server.relay.http.timing import WindowedMaximum

CLOCK_SYNCS_KEPT_S = 30.0
MAX_DETAIL = 200
MAX_ENCODER = 40
# Maximum clock in ms, of a machine that has run for 30 years.
MAX_UPTIME_MS = 1e12
STATES, SOURCES = get_args(State), get_args(Source)


class Frame:
    """One frame on its way through the relay; `timestamp_s` and `received_s` are on the relay's clock.

    `position` counts the frames that came, `sequence` those that the robot's source gave; the robot's own number of it
    is `robot_sequence`. The codec must be known.
    """

    def __init__(
        self, data: bytes, *, sequence: int, position: int, timestamp_s: float, received_s: float
    ) -> None:
        number, flags, quality, self.robot_sequence, _ = HEADER.unpack_from(data)
        self.codec = CODECS[number]
        # Whether it can be decoded without those before it.
        self.is_key = not self.codec.depends_on_earlier or bool(flags & KEY)
        self.sequence = sequence
        self.position = position
        self.timestamp_s = timestamp_s
        self.received_s = received_s
        self.size = len(data) - HEADER.size
        header = HEADER.pack(number, flags, quality, sequence, timestamp_s * 1000)
        start = websocket_header(WHOLE_BINARY, len(data))
        self._begins_at = len(start) + HEADER.size
        # As it is on each viewer's connection.
        self._part: bytes | None = None
        self.message = b"".join((start, header, memoryview(data)[HEADER.size :]))

    @property
    def data(self) -> memoryview:
        """The frame alone, not copied."""
        return memoryview(self.message)[self._begins_at :]

    def part(self, boundary: str, unix_ahead_s: float) -> bytes:
        """Write it as a part of a multipart answer; once, and only when somebody wants it so.

        The next part's boundary is its end: browsers show a part when they have read that.
        """
        if self._part is None:
            head = (
                f"Content-Type: {self.codec.mime_type}\r\n"
                f"X-Timestamp: {self.timestamp_s + unix_ahead_s:.6f}\r\n"
                f"X-Sequence: {self.sequence}\r\n"
                f"Content-Length: {self.size}\r\n\r\n"
            )
            self._part = b"".join((head.encode(), self.data, f"\r\n--{boundary}\r\n".encode()))
        return self._part


class SenderClock:
    """How far the sender's clock is ahead of ours, at most: its answers to clock syncs say it."""

    def __init__(self) -> None:
        self._behind_ms = WindowedMaximum(CLOCK_SYNCS_KEPT_S)
        self._round_trip_s = inf

    @property
    def round_trip_s(self) -> float:
        """The shortest time in which an answer came, 0 before there is any.

        Never that of the last ones alone: where frames fill the line, all of those have waited behind them.
        """
        return 0.0 if self._round_trip_s == inf else self._round_trip_s

    def on_answer(self, now_s: float, t_ms: float, sender_ms: float) -> None:
        """The answer to a clock sync came."""
        self._behind_ms.add(now_s, t_ms - sender_ms)
        self._round_trip_s = min(self._round_trip_s, max(0.0, now_s - t_ms / 1000))

    def ours(self, now_s: float, sender_ms: float) -> float | None:
        """Return in seconds of our clock when the sender's showed this, never later; None: not known."""
        behind_ms = self._behind_ms.at(now_s)
        # A frame of the future is a clock that jumped.
        return None if behind_ms is None else min((sender_ms + behind_ms) / 1000, now_s)


def depends_on_earlier(number: int) -> bool:
    """Whether frames of the codec with this number depend on those before them, as far as it is known here."""
    return number in CODECS and CODECS[number].depends_on_earlier


def parse_frame(data: bytes) -> tuple[int, int, float]:
    """Read a frame's codec, number and timestamp in ms."""
    if not HEADER.size < len(data) <= HEADER.size + MAX_FRAME_BYTES:
        raise ProtocolError("a frame has no header, nothing after it, or more than 10 MiB")
    codec, _, _, sequence, timestamp_ms = HEADER.unpack_from(data)
    # Not a number is in no range.
    if not -MAX_UPTIME_MS <= timestamp_ms <= MAX_UPTIME_MS:
        raise ProtocolError("a frame's timestamp is not a number")
    if depends_on_earlier(codec) and len(data) > HEADER.size + MAX_DEPENDENT_FRAME_BYTES:
        raise ProtocolError("a frame that others depend on has more than 2 MiB")
    return codec, sequence, timestamp_ms


def parse_text(data: bytes) -> dict[str, Any]:
    """Read a text as an object with an `op`."""
    if len(data) > MAX_TEXT_BYTES:
        raise ProtocolError("a text is over 4 KiB")
    try:
        message = json.loads(data)
    except (ValueError, RecursionError) as exc:
        raise ProtocolError("a text is not JSON") from exc
    if not isinstance(message, dict) or not isinstance(message.get("op"), str):
        raise ProtocolError("a text is not an object with an op")
    return message


def parse_stream_request(message: Mapping[str, Any]) -> StreamRequest:
    """Read a stream request; what is not said has its default."""
    default, prefers = StreamRequest(), message.get("prefers")
    request = StreamRequest(
        quality_min=_whole(message, "quality_min", default.quality_min, *QUALITIES),
        quality_max=_whole(message, "quality_max", default.quality_max, *QUALITIES),
        fps=_number(message, "fps", default.fps, *FPS),
        latency_ms=_number(message, "latency_ms", default.latency_ms, *LATENCIES_MS),
        width=_side(message, "width"),
        height=_side(message, "height"),
        codecs=decoded_by(message.get("codecs")),
        prefers=prefers if prefers in PREFERENCES else None,
    )
    if request.quality_min > request.quality_max:
        raise ProtocolError("quality_min is over quality_max")
    if (request.width is None) != (request.height is None):
        raise ProtocolError("width and height go together")
    return request


def combined(request: StreamRequest, other: StreamRequest) -> StreamRequest:
    """Return what serves both: the best that either wants, as quickly as either wants it, in what both decode."""
    larger = max(request, other, key=pixels)
    # Where both differ nobody loses the rate.
    preferences = (request.prefers, other.prefers)
    return StreamRequest(
        quality_min=min(request.quality_min, other.quality_min),
        quality_max=max(request.quality_max, other.quality_max),
        fps=max(request.fps, other.fps),
        latency_ms=min(request.latency_ms, other.latency_ms),
        width=larger.width,
        height=larger.height,
        codecs=tuple(name for name in request.codecs if name in other.codecs),
        prefers="smooth" if "smooth" in preferences else request.prefers or other.prefers,
    )


def pixels(request: StreamRequest) -> int:
    """Return how large it is; nothing is larger than the camera's own size."""
    return MAX_SIDE**2 + 1 if request.width is None else request.width * (request.height or 0)


def parse_credit(message: Mapping[str, Any]) -> tuple[int, int | None]:
    """Read how many more frames may come, and the number of the newest that was taken."""
    sequence = message.get("taken")
    if sequence is not None:
        sequence = _whole(message, "taken", 0, 0, SEQUENCES - 1)
    return _whole(message, "frames", 1, 1, SEQUENCES - 1), sequence


def parse_clock_sync(message: Mapping[str, Any]) -> float:
    """Read the asker's clock in ms."""
    return _number(message, "t_ms", None, -MAX_UPTIME_MS, MAX_UPTIME_MS)


def parse_clock_sync_answer(message: Mapping[str, Any]) -> tuple[float, float]:
    """Read what was asked, and the sender's clock then."""
    sender_ms = _number(message, "sender_ms", None, -MAX_UPTIME_MS, MAX_UPTIME_MS)
    return parse_clock_sync(message), sender_ms


def parse_status(message: Mapping[str, Any]) -> VideoStatus:
    """Keep of a status what viewers know, and nothing that is none of it."""
    state: Any = message.get("state")
    source, detail = message.get("source"), message.get("detail", "")
    codec, encoder = message.get("codec"), message.get("encoder")
    if state not in STATES or not isinstance(detail, str):
        raise ProtocolError("a status has no state")
    return VideoStatus(
        state,
        _printable(detail, MAX_DETAIL),
        source if source in SOURCES else None,
        _optional(message, "quality"),
        _optional(message, "width"),
        _optional(message, "height"),
        _optional(message, "fps"),
        codec if codec in NAMES else None,
        _printable(encoder, MAX_ENCODER) or None,
        _printable(message.get("no_encoder"), MAX_DETAIL),
    )


def write_text(op: str, **members: object) -> bytes:
    """Write a text."""
    return json.dumps({"op": op, **members}, separators=(",", ":")).encode()


def write_message(op: str, **members: object) -> bytes:
    """Write a text as it is on a viewer's connection."""
    text = write_text(op, **members)
    return websocket_header(WHOLE_TEXT, len(text)) + text


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number(
    message: Mapping[str, Any], name: str, default: float | None, low: float, high: float
) -> float:
    value = message.get(name, default)
    # Not a number is in no range.
    if not _is_number(value) or not low <= value <= high:
        raise ProtocolError(f"{name} is not a number from {low:g} to {high:g}")
    return value


def _whole(message: Mapping[str, Any], name: str, default: int, low: int, high: int) -> int:
    value = _number(message, name, default, low, high)
    if value != int(value):
        raise ProtocolError(f"{name} is not a whole number")
    return int(value)


def _side(message: Mapping[str, Any], name: str) -> int | None:
    return None if message.get(name) is None else _whole(message, name, 1, *SIDES)


def _printable(text: object, size: int) -> str:
    """Return the first characters of what somebody sent as text, and nothing of what is none."""
    if not isinstance(text, str):
        return ""
    return "".join(letter if letter.isprintable() else " " for letter in text[:size])


def _optional(message: Mapping[str, Any], name: str) -> float | None:
    """Return a number that may be missing, and that changes nothing when it is none."""
    value = message.get(name)
    return value if _is_number(value) and 0 <= value <= MAX_SIDE else None
