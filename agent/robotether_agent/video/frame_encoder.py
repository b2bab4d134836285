"""Encodes one receiver's frames in the codec that it decodes, or says why they stay JPEGs.

Run by the receiver, which hands over the newest frame when there is credit for it. What is encoded must be sent: the
frames after it depend on it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from math import inf
from typing import NoReturn

from robotether_common.codecs import CODECS, JPEG, Codec
from robotether_common.frames import ENCODER_STARTS, StreamRequest

from robotether_agent.tasks import first_of
from robotether_agent.video.encoder import COMMAND, VideoEncoder, availability
from robotether_agent.video.encoder_messages import EncodedFrame, EncodeRequest, FrameRefusedError
from robotether_agent.video.encoding import KeyFrameLimiter, LoadSteps, bits_per_s, encoded_size
from robotether_agent.video.quality import Level

# Maximum number of cameras that are encoded at once; each takes some 20 MB, with 1920x1080 64.
MAX_ENCODERS = 4
FULL = f"this robot encodes {MAX_ENCODERS} other cameras"
TOO_SLOW = "the encoder does not keep the camera's rate"
SLOWED = "the robot's processor encodes no more than {:.0f} frames a second"
# Time without an encoder after one that was too slow.
TOO_SLOW_PAUSE_S = 60.0
# Minimum rate that the encoder is told: it gives each frame its part of the bits a second.
MIN_FPS = 5.0
# Part of a full line that a robot's cameras may fill together: each frame is gone before the next one comes, though it
# waits for credit, which the one before it brings.
LINE_PART = 0.6
# Minimum rate of a camera that is taken as its interval: in the first seconds few have been counted.
MIN_RATE = 0.5

CODEC_BY_NAME = {codec.name: codec for codec in CODECS.values()}


class EncoderPool:
    """What the receivers of a robot share: whether it encodes, for how many cameras at once, and what does.

    `on_change` gets the encoders at work, or why there are none, at each change. `line_rate` gives the bytes a second
    of a line that is full, None while it is not.
    """

    def __init__(
        self,
        setting: str = "off",
        command: Sequence[str] = COMMAND,
        on_change: Callable[[str], None] = lambda _: None,
        line_rate: Callable[[], int | None] = lambda: None,
    ) -> None:
        self.setting = setting
        self.command = command
        # Who wants an encoder, in the order in which they came, and whether they yield it.
        self._wanting: dict[object, bool] = {}
        self._changed = asyncio.Event()
        self._line_rate = line_rate
        self._on_change = on_change
        self._reports: dict[object, str] = {}

    def enter(self, who: object, *, yields: bool) -> None:
        """Let a receiver want an encoder."""
        self._wanting[who] = yields
        self._notify()

    def update(self, who: object, *, yields: bool) -> None:
        """Note whether a receiver yields from now on, if it wants an encoder."""
        if who in self._wanting:
            self.enter(who, yields=yields)

    def leave(self, who: object) -> None:
        """Let a receiver want none."""
        self._wanting.pop(who, None)
        self._notify()

    def _notify(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()

    def serves(self, who: object) -> bool:
        """Whether an encoder is for this receiver: those that do not yield go first, then who came first."""
        return who in sorted(self._wanting, key=self._wanting.__getitem__)[:MAX_ENCODERS]

    async def until_served(self, who: object, *, is_served: bool) -> None:
        """Wait until an encoder is for this receiver, or is no more."""
        while self.serves(who) is not is_served:
            await self._changed.wait()

    def line_part(self) -> float | None:
        """Return the bits a second of a full line that are for one of the cameras; None while it is not full."""
        rate = self._line_rate()
        return None if rate is None else 8 * LINE_PART * rate / max(1, len(self._reports))

    def report(self, who: object, text: str) -> None:
        """Note what encodes for a receiver, or why nothing does; nothing where that needs no encoder."""
        if self._reports.get(who, "") == text:
            return
        self._reports[who] = text
        self._reports = {each: text for each, text in self._reports.items() if text}
        self._on_change(", ".join(sorted(set(self._reports.values()))))


class FrameEncoder:
    """Which codec one receiver of `camera` gets; `on_change` is called when that changes."""

    def __init__(
        self,
        pool: EncoderPool,
        camera: str,
        on_change: Callable[[], None],
        clock: Callable[[], float],
    ) -> None:
        self._pool = pool
        self._on_change = on_change
        self._clock = clock
        self._requested = JPEG
        self._needed, self._unneeded = asyncio.Event(), asyncio.Event()
        # Looked at anew for each receiver: PyAV may be installed while the agent runs.
        self._unavailable = availability(pool.setting)
        self._encoder = VideoEncoder(self._on_encoder, camera, pool.command, clock)
        self._key_frames = KeyFrameLimiter()
        self._load = LoadSteps(clock())
        self._requested_fps = StreamRequest.fps
        self._yields = False
        self.name: str | None = None
        self.size: tuple[int, int] | None = None
        self._own_size: tuple[int, int] | None = None

    @property
    def codec(self) -> Codec:
        """The codec of frames that are sent now; JPEG: as the source gives them."""
        return JPEG if self.down_reason else self._requested

    @property
    def down_reason(self) -> str:
        """Why a receiver that decodes more than JPEG gets JPEGs; empty where it does not."""
        if self._requested is JPEG:
            return ""
        return self._unavailable or self._encoder.down_reason

    @property
    def max_fps(self) -> float:
        """How many frames a second are encoded at most."""
        return inf if self.codec is JPEG else self._load.max_fps

    @property
    def shortfall(self) -> str:
        """Why a receiver that decodes more than JPEG gets JPEGs, or fewer frames; empty where it does not."""
        if self.max_fps < self._requested_fps:
            return SLOWED.format(self.max_fps)
        return self.down_reason

    def use(self, stream_request: StreamRequest) -> None:
        """Encode in the first codec that the receiver decodes, as soon as the encoder runs."""
        requested = CODEC_BY_NAME[stream_request.codecs[0]]
        if requested is not self._requested:
            self._key_frames.request()
        self._requested, self._requested_fps = requested, stream_request.fps
        self._yields = stream_request.yields
        if requested is JPEG:
            self._needed.clear()
            self._unneeded.set()
        elif not self._unavailable:
            self._unneeded.clear()
            self._needed.set()
            self._pool.update(self, yields=self._yields)

    def carries(self, stream_request: StreamRequest) -> Callable[[Level], bool] | None:
        """Return which levels the full line carries; None while it is not full, or nothing is encoded."""
        own, part = self._own_size, self._pool.line_part()
        if self.codec is JPEG or own is None or part is None:
            return None
        return lambda level: bits_of(level, own, stream_request) <= part

    def note_size(self, size: tuple[int, int] | None) -> None:
        """Note the size of the next frame, None if that is not a JPEG."""
        self._own_size = size

    def request_key_frame(self) -> None:
        """Make one of the next frames a key frame."""
        self._key_frames.request()

    async def run(self) -> NoReturn:
        """Keep an encoder running while the receiver wants one; none runs after this was cancelled."""
        while True:
            await self._needed.wait()
            try:
                await first_of(self._keep_ready(), self._unneeded.wait())
            finally:
                self._pool.leave(self)
                self._pool.report(self, "")

    async def encode(
        self, jpeg: bytes, level: Level, stream_request: StreamRequest, rate: float
    ) -> EncodedFrame:
        """Return a frame of the size that was noted; `rate` is the camera's in frames a second. Raises EncoderError."""
        own = self._own_size
        if self.codec is JPEG or own is None:
            raise FrameRefusedError(self.down_reason or "the camera's frame is not a JPEG")
        size = encoded_size(own, requested_size(stream_request), level.scale)
        requested_fps = stream_request.fps * level.rate
        request = EncodeRequest(
            jpeg=jpeg,
            codec=self._requested,
            width=size[0],
            height=size[1],
            bits_per_s=bits_of(level, own, stream_request),
            fps=max(MIN_FPS, requested_fps),
            preset=self._load.preset,
            requests_key=self._key_frames.is_due(self._clock()),
        )
        frame = await self._encoder.encode(request)
        self.name, self.size = frame.encoder, size
        reason = self.shortfall
        self._pool.report(self, f"{self.name}: {reason}" if reason else self.name)
        if frame.is_key:
            self._key_frames.on_key_frame(self._clock())
        self._judge(frame.took_s, min(requested_fps, max(MIN_RATE, rate)))
        return frame

    def _on_encoder(self) -> None:
        """The encoder runs, or fails."""
        if reason := self._encoder.down_reason:
            self._pool.report(self, f"none: {reason}")
        self._on_change()

    def _judge(self, took_s: float, fps: float) -> None:
        now_s = self._clock()
        if not self._load.on_encoded(now_s, took_s, fps):
            self._load.restart(now_s)
            self._encoder.fail(TOO_SLOW, min_pause_s=TOO_SLOW_PAUSE_S)

    async def _keep_ready(self) -> NoReturn:
        self._pool.enter(self, yields=self._yields)
        while True:
            if not self._pool.serves(self):
                self._encoder.down_reason = FULL
                self._on_encoder()
                await self._pool.until_served(self, is_served=True)
            self._encoder.down_reason = ENCODER_STARTS
            await first_of(self._encoder.run(), self._pool.until_served(self, is_served=False))


def bits_of(level: Level, own: tuple[int, int], stream_request: StreamRequest) -> int:
    """Return the bits a second of a camera of this size in pixels at a level."""
    size = encoded_size(own, requested_size(stream_request), level.scale)
    return bits_per_s(level.quality, size, max(MIN_FPS, stream_request.fps * level.rate))


def requested_size(stream_request: StreamRequest) -> tuple[int, int] | None:
    """Return the requested width and height; nothing for the camera's own."""
    if stream_request.width is None or stream_request.height is None:
        return None
    return stream_request.width, stream_request.height
