"""One receiver of a camera's frames: its messages (docs/reference/media.md), its credit, and the newest frame for it.

Run by the frames service for each WebSocket. It sends the newest frame for each credit; a receiver that takes nothing
for IDLE_S keeps no source open. Holds one frame, another one while it is encoded, and a few texts. H.264 that the robot
encodes itself goes out frame by frame, and few frames wait.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from aiohttp import WSMsgType, web
from robotether_common.codecs import H264, JPEG, Codec
from robotether_common.frames import MAX_CREDITS, SEQUENCES, StreamRequest, VideoStatus

from robotether_agent.clock import robot_time
from robotether_agent.tasks import first_of
from robotether_agent.video.encoder_messages import EncoderError
from robotether_agent.video.encoding import encoded_size
from robotether_agent.video.frame_encoder import EncoderPool, FrameEncoder, requested_size
from robotether_agent.video.frame_messages import (
    ClockSync,
    Credit,
    Header,
    KeyFrameRequest,
    parse,
)
from robotether_agent.video.jpeg import jpeg_size
from robotether_agent.video.quality import Level, Steps, ladder
from robotether_agent.video.shared_sources import SharedSources, SourceSwitch
from robotether_agent.video.sources import CameraFrame, SourceRequest
from robotether_agent.video.waiting_frames import NewFrame, WaitingFrames

# Maximum number of frames saved for jitter: a camera at the requested rate is early as often as
# late.
MAX_SAVED = 2.0
IDLE_S = 2.0
CHECK_EVERY_S = 0.25
STATUS_EVERY_S = 1.0
MAX_TEXTS = 8
# Default quality of JPEGs that are encoded again, whatever the level: a step opens no other source.
SOURCE_QUALITY = 90
# Time limit for a look at the camera's own size, which opens a source: a slow camera takes its time.
SIZE_WITHIN_S = 10.0
# Time over which frames are counted for a rate.
COUNTED_S = 2.0
# What a status names as the encoder of H.264 that the robot's own nodes publish.
OWN_ENCODER = "the camera"

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


# What a frame shows of the line: its source's request, and the level at which it was encoded.
Basis = tuple[SourceRequest, "Level | None"]


@dataclass(frozen=True)
class SentFrame:
    """A frame that is under way; without a basis it shows nothing of the line."""

    sequence: int
    arrived_s: float
    basis: Basis | None


@dataclass(frozen=True)
class OutgoingFrame:
    """A frame as it goes out."""

    new: NewFrame
    data: bytes
    codec: Codec
    quality: int
    basis: Basis | None
    is_key: bool = False


class Receiver:
    """One end of the frames protocol; make it, then await run()."""

    def __init__(
        self,
        socket: web.WebSocketResponse,
        topic: str,
        shared_sources: SharedSources,
        *,
        steps_quality: Callable[[], bool],
        encoders: EncoderPool | None = None,
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
        self._shared_sources = shared_sources
        self._source_switch = SourceSwitch(shared_sources, self._on_frame, clock)
        self._encoder = FrameEncoder(encoders or EncoderPool(), topic, self._on_encoder, clock)
        self._stream_request: StreamRequest | None = None
        self._steps: Steps | None = None
        self._limiter = FrameRateLimiter(StreamRequest.fps)
        self._credit = 0
        self._credit_s = clock()
        # No receiver of this camera uses the numbers of another one, which takes fewer than 1000 frames a second.
        self._sequence = int(clock() * 1000) % SEQUENCES
        self._waiting = WaitingFrames()
        # Whether the robot encodes by itself, so that nothing can be asked of the source nor of an encoder.
        self._passes_on = False
        # At most one frame is being encoded or waits encoded, and the next one waits for it.
        self._to_encode: NewFrame | None = None
        self._has_to_encode = asyncio.Event()
        self._encoded: OutgoingFrame | None = None
        self._codec: Codec | None = None
        self._in_flight: deque[SentFrame] = deque(maxlen=MAX_CREDITS)
        self._texts: deque[JsonFields] = deque(maxlen=MAX_TEXTS)
        self._status: VideoStatus | None = None
        self._status_s = self._checked_s = clock() - STATUS_EVERY_S
        self._offered, self._sent = FrameRateCounter(), FrameRateCounter()
        self._wake = asyncio.Event()

    @property
    def yields(self) -> bool:
        """Whether what else the robot sends goes before these frames."""
        return self._stream_request is not None and self._stream_request.yields

    async def run(self) -> None:
        """Serve until the receiver leaves; FieldError for a text that breaks the protocol."""
        try:
            await first_of(
                self._listen(),
                self._send(),
                self._keep_checking(),
                self._keep_size(),
                self._encode(),
                self._encoder.run(),
            )
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
        elif isinstance(request, KeyFrameRequest):
            self._encoder.request_key_frame()
        elif isinstance(request, StreamRequest):
            self._on_request(request)

    def _on_request(self, stream_request: StreamRequest) -> None:
        before = self._stream_request
        if before is None or before.fps != stream_request.fps:
            self._limiter = FrameRateLimiter(stream_request.fps)
        if before is None or before.prefers != stream_request.prefers:
            # From the best down, by the other rule.
            self._steps = None
        self._stream_request = stream_request
        self._credit_s = self._clock()
        self._use_encoder()
        self._use_levels(stream_request)
        self._follow()
        self._check()

    def _use_encoder(self) -> None:
        if self._stream_request is not None:
            jpegs = replace(self._stream_request, codecs=(JPEG.name,))
            self._encoder.use(jpegs if self._passes_on else self._stream_request)

    def _on_encoder(self) -> None:
        """Request of the source what is encoded from now on, or what is sent as it comes."""
        if self._is_encoding:
            # What the line did not carry as JPEG it may carry now.
            self._steps = None
        if self._stream_request is not None:
            self._use_levels(self._stream_request)
            self._judge_line(self._stream_request, self._clock())
            self._follow()
        self._wake.set()

    @property
    def _is_encoding(self) -> bool:
        return self._encoder.codec is not JPEG

    def _use_levels(self, stream_request: StreamRequest) -> None:
        """Make quality and size steps of what is wanted, and of what is known of the camera."""
        has_size = self._own_size is not None or stream_request.width is not None
        scales = self._is_encoding or (self._can_scale and has_size)
        levels = ladder(stream_request, scales=scales)
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
            or sent.basis is None
            or sent.basis != self._basis()
            or not self._can_step()
        ):
            return
        if self._steps.on_taken(now_s, now_s - sent.arrived_s):
            self._follow()

    def _can_step(self) -> bool:
        """Whether frames have the quality that is in force."""
        return self._is_encoding or (self._steps_quality() and self._is_by_server)

    @property
    def _is_by_server(self) -> bool:
        """Whether web_video_server gives the frames, in the requested quality and size."""
        return self._source_switch.condition().source == "web_video_server"

    def _basis(self) -> Basis | None:
        """Return what a frame that is sent now shows of the line."""
        source_request = self._source_switch.source_request
        if source_request is None:
            return None
        level = self._steps.level if self._is_encoding and self._steps is not None else None
        return source_request, level

    def _follow(self) -> None:
        if self._stream_request is None or self._steps is None:
            return
        self._limiter.fps = self._fps(self._stream_request, self._steps)
        source_request = self._source_request(self._stream_request, self._steps)
        before = self._source_switch.source_request
        if self._passes_on and before is not None and before.passes_h264:
            # All else is the robot's.
            source_request = replace(before, passes_h264=source_request.passes_h264)
        self._source_switch.follow(source_request)

    def _fps(self, stream_request: StreamRequest, steps: Steps) -> float:
        """Return the rate that line and processor carry, in frames a second."""
        rate = steps.level.rate if self._can_step() else 1.0
        return min(stream_request.fps * rate, self._encoder.max_fps)

    def _source_request(self, stream_request: StreamRequest, steps: Steps) -> SourceRequest:
        fps, passes_h264 = stream_request.fps, H264.name in stream_request.codecs
        if not self._steps_quality():
            return SourceRequest(self._topic, 0, None, None, fps, passes_h264)
        level = Level(SOURCE_QUALITY) if self._is_encoding else steps.level
        width, height = self._source_size(requested_size(stream_request), level) or (None, None)
        return SourceRequest(self._topic, level.quality, width, height, fps, passes_h264)

    def _source_size(
        self, requested: tuple[int, int] | None, level: Level
    ) -> tuple[int, int] | None:
        """Return the size that is asked of the source, in the camera's shape if that is known; None: its own."""
        own = self._own_size
        if own is None:
            return requested and encoded_size(requested, None, level.scale)
        if requested is None and level.scale == 1 and not self._is_encoding:
            return None
        size = encoded_size(own, requested, level.scale)
        # Sides are even.
        return size if size[0] < own[0] - 1 else None

    def _on_frame(self, frame: CameraFrame, source_request: SourceRequest) -> None:
        now_s = self._clock()
        self._sequence = (self._sequence + 1) % SEQUENCES
        self._note_codec(frame)
        if not self._passes_on and not self._limiter.allows(now_s):
            return
        self._offered.note(now_s)
        self._waiting.put(NewFrame(self._sequence, frame, source_request), now_s)
        self._wake.set()

    def _note_codec(self, frame: CameraFrame) -> None:
        is_encoded = frame.codec.depends_on_earlier
        if is_encoded != self._passes_on:
            self._passes_on = is_encoded
            self._use_encoder()

    def _note_size(self, new: NewFrame) -> None:
        """Note the size of the frame that is sent next."""
        size = jpeg_size(new.frame.data) if new.frame.codec is JPEG else None
        self._encoder.note_size(size)
        if new.source_request.width is None or not self._is_by_server:
            self._learn_size(size)

    def _learn_size(self, size: tuple[int, int] | None) -> None:
        """Note the camera's own size, or that it has another one now."""
        if size is None or size == self._own_size:
            return
        self._own_size = size
        if self._stream_request is not None:
            self._use_levels(self._stream_request)
            self._follow()

    async def _keep_size(self) -> None:
        """Learn the camera's own size now and then while its frames are requested in another one.

        web_video_server makes the requested size of any shape.
        """
        while True:
            await asyncio.sleep(CHECK_EVERY_S)
            sized, condition = self._source_switch.source_request, self._source_switch.condition()
            if sized is None or sized.width is None:
                continue
            if condition.state == "live" and self._is_by_server:
                self._learn_size(await self._shared_sources.own_size(sized, SIZE_WITHIN_S))

    async def _send(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._texts:
                await self._socket.send_str(json.dumps(self._texts.popleft()))
            if self._encoded is not None:
                outgoing, self._encoded = self._encoded, None
                await self._send_frame(outgoing)
                self._wake.set()
            elif self._credit and self._to_encode is None and (new := self._waiting.next()):
                self._credit -= 1
                self._note_size(new)
                if self._is_encoding and new.frame.codec is JPEG:
                    self._to_encode = new
                    self._has_to_encode.set()
                else:
                    await self._send_frame(self._unencoded(new))
                    self._wake.set()

    async def _encode(self) -> None:
        """Encode beside `_send`, which answers clock syncs meanwhile."""
        while True:
            await self._has_to_encode.wait()
            self._has_to_encode.clear()
            if self._to_encode is not None:
                self._encoded = await self._as_encoded(self._to_encode)
            self._to_encode = None
            self._wake.set()

    async def _as_encoded(self, new: NewFrame) -> OutgoingFrame | None:
        """Return a frame encoded, or as it came if that fails; nothing if there is a newer one to send in its place."""
        if self._stream_request is None or self._steps is None:
            return None
        level, codec, basis = self._steps.level, self._encoder.codec, self._basis()
        rate = self._offered.rate(self._clock())
        try:
            encoded = await self._encoder.encode(new.frame.data, level, self._stream_request, rate)
        except EncoderError:
            # What follows must not depend on a frame that is none.
            self._encoder.request_key_frame()
            if self._waiting:
                self._credit += 1
                return None
            return self._unencoded(new)
        self._limiter.fps = self._fps(self._stream_request, self._steps)
        return OutgoingFrame(new, encoded.data, codec, level.quality, basis, encoded.is_key)

    def _unencoded(self, new: NewFrame) -> OutgoingFrame:
        can_step = self._can_step() and not self._is_encoding
        quality = new.source_request.quality if can_step else 0
        basis = None if self._is_encoding else (new.source_request, None)
        frame = new.frame
        return OutgoingFrame(new, frame.data, frame.codec, quality, basis, frame.is_key)

    async def _send_frame(self, outgoing: OutgoingFrame) -> None:
        sequence, frame = outgoing.new.sequence, outgoing.new.frame
        self._in_flight.append(SentFrame(sequence, frame.arrived_s, outgoing.basis))
        self._sent.note(self._clock())
        self._codec = outgoing.codec
        # Before it can be seen.
        self._on_frame_sent(self._topic, sequence, frame.timestamp_s)
        header = Header(
            sequence,
            frame.timestamp_s * 1000,
            outgoing.quality,
            frame.is_stamped,
            outgoing.codec,
            outgoing.is_key,
        )
        await self._socket.send_bytes(header.packed() + outgoing.data)

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
            self._waiting = WaitingFrames()
            return
        if self._source_switch.give_up_late() and self._can_scale:
            # It may be that it knows no sizes.
            self._can_scale = False
            self._use_levels(self._stream_request)
            self._follow()
        self._judge_line(self._stream_request, now_s)
        if now_s - self._checked_s >= 1:
            self._checked_s = now_s
            self._judge_rates(now_s)
        if now_s - self._status_s >= STATUS_EVERY_S:
            self._send_status(now_s)

    def _judge_line(self, stream_request: StreamRequest, now_s: float) -> None:
        carries = self._encoder.carries(stream_request)
        if self._steps is None or carries is None:
            return
        if self._steps.on_full_line(now_s, carries):
            self._follow()

    def _judge_rates(self, now_s: float) -> None:
        if self._steps is None or not self._can_step():
            return
        if self._steps.on_rates(now_s, self._offered.rate(now_s), self._sent.rate(now_s)):
            self._follow()

    def _send_status(self, now_s: float) -> None:
        condition = self._source_switch.condition()
        if condition.state == "live" and (lack := self._waiting.lack(now_s)):
            condition = replace(condition, state="down", detail=lack)
        status = replace(
            condition,
            fps=round(self._sent.rate(now_s), 1),
            codec=None if self._codec is None else self._codec.name,
            no_encoder=self._encoder.shortfall,
            **(self._encoded_status() if self._is_encoding else self._source_status()),
        )
        if status != self._status:
            self._status, self._status_s = status, now_s
            self._queue_text({"op": "status", **asdict(status)})

    def _source_status(self) -> dict[str, Any]:
        source_request = self._source_switch.source_request if self._can_step() else None
        return {
            "quality": 0 if source_request is None else source_request.quality,
            "width": None if source_request is None else source_request.width,
            "height": None if source_request is None else source_request.height,
            "encoder": OWN_ENCODER if self._passes_on else None,
        }

    def _encoded_status(self) -> dict[str, Any]:
        width, height = self._encoder.size or (None, None)
        return {
            "quality": 0 if self._steps is None else self._steps.level.quality,
            "width": width,
            "height": height,
            "encoder": self._encoder.name,
        }
