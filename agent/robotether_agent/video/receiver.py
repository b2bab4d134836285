"""One receiver of a camera's frames: its messages (docs/reference/media.md), its credit, and the newest frame for it.

Run by the frames service for each WebSocket. A frame goes out for a credit only, and then the newest; whoever takes
nothing for IDLE_S has no source open. Holds one frame and a few texts. A broken text names its field; an unknown `op`
is nothing, so that the other side may be newer.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from aiohttp import WSMsgType, web
from robotether_common.codecs import JPEG, Codec
from robotether_common.frames import (
    FPS,
    HEADER,
    LATENCIES_MS,
    MAX_CREDITS,
    QUALITIES,
    SEQUENCES,
    SIDES,
    STAMPED,
    StreamRequest,
    VideoStatus,
)

from robotether_agent.clock import robot_time
from robotether_agent.fields import (
    FieldError,
    JsonObject,
    get_int,
    get_number,
    get_text,
    parse_object,
)
from robotether_agent.tasks import first_of
from robotether_agent.video.jpeg import jpeg_size
from robotether_agent.video.quality import Steps, ladder
from robotether_agent.video.shared_sources import SharedSources, SourceSwitch
from robotether_agent.video.sources import CameraFrame, SourceRequest

# Maximum number of frames saved for jitter: a camera at the requested rate is early as often as
# late.
MAX_SAVED = 2.0
IDLE_S = 2.0
CHECK_EVERY_S = 0.25
STATUS_EVERY_S = 1.0
MAX_TEXTS = 8
# Maximum number of unconfirmed frames; a receiver that keeps the rules never has as many.
MAX_IN_FLIGHT = 8
MIN_SIZE = 16
# Time over which frames are counted for a rate.
COUNTED_S = 2.0

# Maximum clock of a browser in ms, so that a sum never loses its fractions.
MAX_CLOCK_MS = 1e13

Getter = Callable[[JsonObject, str, Any, Any], Any]
JsonFields = dict[str, object]
# Is notified of the camera, number and timestamp in seconds of each frame that leaves the robot.
OnFrameSent = Callable[[str, int, float], None]


class FrameRateLimiter:
    """Lets `fps` frames a second through, spread evenly over those that come."""

    def __init__(self, fps: float) -> None:
        self.fps = fps
        self._saved = MAX_SAVED
        self._at_s: float | None = None

    def allows(self, now_s: float) -> bool:
        """Return whether the frame that came now goes on."""
        if self._at_s is not None:
            gained = max(0.0, now_s - self._at_s) * self.fps
            self._saved = min(MAX_SAVED, self._saved + gained)
        self._at_s = now_s
        if self._saved < 1:
            return False
        self._saved -= 1
        return True


class FrameRateCounter:
    """How many came in a second, of the last COUNTED_S seconds."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=256)

    def note(self, now_s: float) -> None:
        """Count one."""
        self._times.append(now_s)

    def rate(self, now_s: float) -> float:
        """Return how many a second."""
        while self._times and self._times[0] <= now_s - COUNTED_S:
            self._times.popleft()
        return len(self._times) / COUNTED_S


@dataclass(frozen=True)
class SentFrame:
    """A frame that is under way."""

    sequence: int
    arrived_s: float
    source_request: SourceRequest


class Receiver:
    """One end of the frames protocol; make it, then await run()."""

    def __init__(
        self,
        socket: web.WebSocketResponse,
        topic: str,
        shared_sources: SharedSources,
        *,
        steps_quality: bool,
        on_frame_sent: OnFrameSent = lambda *_: None,
        clock: Callable[[], float] = robot_time,
    ) -> None:
        self._socket = socket
        self._topic = topic
        self._clock = clock
        self._on_frame_sent = on_frame_sent
        self._steps_quality = steps_quality
        self._can_scale = True
        self._own_size: tuple[int, int] | None = None
        self._source_switch = SourceSwitch(shared_sources, self._on_frame, clock)
        self._stream_request: StreamRequest | None = None
        self._steps: Steps | None = None
        self._limiter = FrameRateLimiter(StreamRequest.fps)
        self._credit = 0
        self._credit_s = clock()
        # No receiver of this camera uses the numbers of another one, which takes fewer than 1000 frames a second.
        self._sequence = int(clock() * 1000) % SEQUENCES
        self._newest: tuple[int, CameraFrame, SourceRequest] | None = None
        self._in_flight: deque[SentFrame] = deque(maxlen=MAX_IN_FLIGHT)
        self._texts: deque[JsonFields] = deque(maxlen=MAX_TEXTS)
        self._status: VideoStatus | None = None
        self._status_s = self._checked_s = clock() - STATUS_EVERY_S
        self._offered, self._sent = FrameRateCounter(), FrameRateCounter()
        self._wake = asyncio.Event()

    async def run(self) -> None:
        """Serve until the receiver leaves; FieldError for a text that breaks the protocol."""
        try:
            await first_of(self._listen(), self._send(), self._keep_checking())
        finally:
            self._source_switch.leave()

    async def _listen(self) -> None:
        async for message in self._socket:
            if message.type is WSMsgType.TEXT:
                self._on_text(message.data)

    def _on_text(self, text: str) -> None:
        request = parse(text)
        if isinstance(request, ClockSync):
            # Read now: it may wait behind a frame, which does not make the clock another one.
            self._queue_text(
                {"op": "clock_sync", "t_ms": request.t_ms, "sender_ms": self._clock() * 1000}
            )
        elif isinstance(request, Credit):
            self._on_credit(request)
        elif isinstance(request, StreamRequest):
            self._on_request(request)

    def _on_request(self, stream_request: StreamRequest) -> None:
        if self._stream_request is None or self._stream_request.fps != stream_request.fps:
            self._limiter = FrameRateLimiter(stream_request.fps)
        self._stream_request = stream_request
        self._credit_s = self._clock()
        self._use_levels(stream_request)
        self._follow()
        self._check()

    def _use_levels(self, stream_request: StreamRequest) -> None:
        """Make quality and size steps of what is wanted, and of what is known of the camera."""
        has_size = self._own_size is not None or stream_request.width is not None
        levels = ladder(
            stream_request.quality_min,
            stream_request.quality_max,
            scales=self._can_scale and has_size,
        )
        now_s, latency_s = self._clock(), stream_request.latency_ms / 1000
        if self._steps is None:
            self._steps = Steps(levels, latency_s, now_s)
        else:
            self._steps.use(levels, latency_s, now_s)

    def _on_credit(self, credit: Credit) -> None:
        now_s = self._clock()
        self._credit = min(MAX_CREDITS, self._credit + credit.frames)
        self._credit_s = now_s
        if credit.taken is not None:
            self._on_taken(credit.taken, now_s)
        if self._source_switch.source_request is None:
            self._follow()
        self._wake.set()

    def _on_taken(self, sequence: int, now_s: float) -> None:
        if all(sent.sequence != sequence for sent in self._in_flight):
            return
        sent = self._in_flight.popleft()
        while sent.sequence != sequence:
            sent = self._in_flight.popleft()
        if (
            self._steps is None
            or sent.source_request != self._source_switch.source_request
            or not self._can_step()
        ):
            return
        if self._steps.on_taken(now_s, now_s - sent.arrived_s):
            self._follow()

    def _can_step(self) -> bool:
        """Whether the source gives the quality that it is asked for."""
        return self._steps_quality and self._source_switch.condition().source == "web_video_server"

    def _follow(self) -> None:
        if self._stream_request is not None and self._steps is not None:
            self._source_switch.follow(self._source_request(self._stream_request, self._steps))

    def _source_request(self, stream_request: StreamRequest, steps: Steps) -> SourceRequest:
        if not self._steps_quality:
            return SourceRequest(self._topic, 0, None, None, stream_request.fps)
        level = steps.level
        width, height = stream_request.width, stream_request.height
        if level.scale < 1:
            whole = self._own_size
            if stream_request.width is not None and stream_request.height is not None:
                whole = stream_request.width, stream_request.height
            if whole is not None:
                width, height = (max(MIN_SIZE, int(side * level.scale) // 2 * 2) for side in whole)
        return SourceRequest(self._topic, level.quality, width, height, stream_request.fps)

    def _on_frame(self, frame: CameraFrame, source_request: SourceRequest) -> None:
        now_s = self._clock()
        self._sequence = (self._sequence + 1) % SEQUENCES
        if self._own_size is None and source_request.width is None:
            self._learn_size(frame)
        if not self._limiter.allows(now_s):
            return
        self._offered.note(now_s)
        self._newest = self._sequence, frame, source_request
        self._wake.set()

    def _learn_size(self, frame: CameraFrame) -> None:
        self._own_size = jpeg_size(frame.data)
        if self._own_size is not None and self._stream_request is not None:
            self._use_levels(self._stream_request)

    async def _send(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._texts:
                await self._socket.send_str(json.dumps(self._texts.popleft()))
            if self._credit and self._newest is not None:
                await self._send_frame(*self._newest)
                self._wake.set()

    async def _send_frame(
        self, sequence: int, frame: CameraFrame, source_request: SourceRequest
    ) -> None:
        self._newest = None
        self._credit -= 1
        self._in_flight.append(SentFrame(sequence, frame.arrived_s, source_request))
        self._sent.note(self._clock())
        quality = source_request.quality if self._can_step() else 0
        # Before it can be seen.
        self._on_frame_sent(self._topic, sequence, frame.timestamp_s)
        header = Header(sequence, frame.timestamp_s * 1000, quality, frame.is_stamped, frame.codec)
        await self._socket.send_bytes(header.packed() + frame.data)

    def _queue_text(self, text: JsonFields) -> None:
        self._texts.append(text)
        self._wake.set()

    async def _keep_checking(self) -> None:
        while True:
            await asyncio.sleep(CHECK_EVERY_S)
            self._check()

    def _check(self) -> None:
        """Do what no message brings: let go of a source without credit, judge rates, send the status."""
        if self._stream_request is None:
            return
        now_s = self._clock()
        if self._credit == 0 and now_s - self._credit_s > IDLE_S:
            self._source_switch.leave()
            self._newest = None
            return
        if self._source_switch.give_up_late() and self._can_scale:
            # It may be that it knows no sizes.
            self._can_scale = False
            self._use_levels(self._stream_request)
            self._follow()
        if now_s - self._checked_s >= 1:
            self._checked_s = now_s
            self._judge_rates(now_s)
        if now_s - self._status_s >= STATUS_EVERY_S:
            self._send_status(now_s)

    def _judge_rates(self, now_s: float) -> None:
        if self._steps is None or not self._can_step():
            return
        if self._steps.on_rates(now_s, self._offered.rate(now_s), self._sent.rate(now_s)):
            self._follow()

    def _send_status(self, now_s: float) -> None:
        source_request = self._source_switch.source_request if self._can_step() else None
        status = replace(
            self._source_switch.condition(),
            quality=0 if source_request is None else source_request.quality,
            width=None if source_request is None else source_request.width,
            height=None if source_request is None else source_request.height,
            fps=round(self._sent.rate(now_s), 1),
        )
        if status != self._status:
            self._status, self._status_s = status, now_s
            self._queue_text({"op": "status", **asdict(status)})


@dataclass(frozen=True)
class Header:
    """What a frame's header says; `timestamp_ms` is on the sender's clock, `quality` 0 is unknown."""

    sequence: int
    timestamp_ms: float
    quality: int = 0
    is_stamped: bool = False
    codec: Codec = JPEG

    def packed(self) -> bytes:
        """Return the header as it is on the wire."""
        flags = STAMPED if self.is_stamped else 0
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


Request = StreamRequest | Credit | ClockSync


def parse(text: bytes | str) -> Request | None:
    """Return what a text asks, or nothing for an unknown `op`; FieldError for a broken one."""
    message = parse_object(text, "the text")
    reader = READERS.get(get_text(message, "op", limit=50))
    return None if reader is None else reader(message)


def _stream_request(message: JsonObject) -> StreamRequest:
    request = StreamRequest(
        quality_min=_or(message, "quality_min", StreamRequest.quality_min, get_int, of=QUALITIES),
        quality_max=_or(message, "quality_max", StreamRequest.quality_max, get_int, of=QUALITIES),
        fps=_or(message, "fps", StreamRequest.fps, get_number, of=FPS),
        latency_ms=_or(
            message, "latency_ms", StreamRequest.latency_ms, get_number, of=LATENCIES_MS
        ),
        width=_or(message, "width", None, get_int, of=SIDES),
        height=_or(message, "height", None, get_int, of=SIDES),
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


def _clock_sync(message: JsonObject) -> ClockSync:
    return ClockSync(get_number(message, "t_ms", -MAX_CLOCK_MS, MAX_CLOCK_MS))


def _or(message: JsonObject, name: str, default: Any, get: Getter, *, of: tuple[Any, Any]) -> Any:
    """Return the field, within the bounds `of`, or its default where it is missing or null."""
    return default if message.get(name) is None else get(message, name, *of)


READERS: dict[str, Callable[[JsonObject], Request]] = {
    "stream_request": _stream_request,
    "credit": _credit,
    "clock_sync": _clock_sync,
}
