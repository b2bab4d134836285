"""One local source for each camera and request, shared by all receivers who request the same; none without a receiver.

A shared source keeps no frame: it hands each one to its receivers, which keep the newest that they have not sent. A
source that ends or stalls is reopened, at growing intervals.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace
from math import inf
from random import Random

from robotether_common.frames import Source, VideoStatus, no_frames

from robotether_agent.backoff import delays
from robotether_agent.clock import robot_time
from robotether_agent.fields import printable
from robotether_agent.tasks import within
from robotether_agent.video.jpeg import jpeg_size
from robotether_agent.video.sources import (
    CameraFrame,
    OnFrame,
    OnKind,
    SourceDownError,
    SourceRequest,
)

# Time without a frame after which an open source is waiting.
WAITS_AFTER_S = 2.0
# Time without a frame after which a source counts as down; one that cannot be opened fails sooner.
SILENT_AFTER_S = 4.0
MAX_PAUSE_S = 5.0
MAX_SHARED_SOURCES = 8
GIVE_UP_S = 5.0
# Time after which a camera's own size is looked at again, as its node may have changed it, and the quality of the frame
# that shows it.
SIZE_KEPT_S, SIZE_QUALITY = 30.0, 1
# Part of the interval between frames in which a frame of another source is the same frame.
SAME = 0.5
MAX_INTERVAL_S = 1.0

# Runs a source of a request until it ends, as Sources.run does.
Run = Callable[[SourceRequest, OnFrame, OnKind], Awaitable[None]]
# Returns which request is answered in place of another one, as Sources.answered does.
Answered = Callable[[SourceRequest], SourceRequest]

log = logging.getLogger(__name__)


class SharedSource:
    """A source that runs as long as somebody follows it."""

    def __init__(self, source_request: SourceRequest, run: Run, clock: Callable[[], float]) -> None:
        self.source_request = source_request
        self.followers: dict[object, OnFrame] = {}
        self._run = run
        self._clock = clock
        self._kind: Source = "web_video_server"
        self._down = ""
        self._last_s: float | None = None
        # Since when the source is open, None between two attempts.
        self._opened_s: float | None = None
        # Seeded by chance: the pauses of several cameras need not fall together.
        self._pauses = delays(Random())  # noqa: S311
        self._task = asyncio.ensure_future(self._keep_open())

    def condition(self) -> VideoStatus:
        """Report how the source is now."""
        now_s = self._clock()
        if self._is_silent(now_s):
            return VideoStatus("down", self._silence(), self._kind)
        if self._down:
            return VideoStatus("down", self._down, self._kind)
        is_live = self._last_s is not None and now_s - self._last_s < WAITS_AFTER_S
        return VideoStatus("live" if is_live else "waiting", "", self._kind)

    def _is_silent(self, now_s: float) -> bool:
        if self._opened_s is None:
            return False
        # rosbridge sends no more often than it is asked to.
        limit_s = max(SILENT_AFTER_S, 3 / self.source_request.fps)
        return now_s - max(self._opened_s, self._last_s or 0.0) >= limit_s

    def _silence(self) -> str:
        """Say of whom nothing comes: a topic, or a camera of the settings."""
        name = self.source_request.topic
        if self._kind == "mjpeg":
            return f"camera {printable(name, 100)} has sent no frame for {SILENT_AFTER_S:g} s"
        return no_frames(name)

    def end(self) -> asyncio.Future[None]:
        """Close the source."""
        self._task.cancel()
        return self._task

    async def _keep_open(self) -> None:
        while True:
            self._opened_s = self._clock()
            try:
                await self._run(self.source_request, self._on_frame, self._on_kind)
            except SourceDownError as down:
                self._is_down(str(down))
            except Exception:
                log.exception("the source of %s failed", self.source_request.topic)
                self._is_down("the agent failed; see its log")
            self._opened_s = None
            await asyncio.sleep(min(MAX_PAUSE_S, next(self._pauses)))

    def _is_down(self, detail: str) -> None:
        if detail != self._down:
            log.info("no frames of %s: %s", self.source_request.topic, detail)
        self._down = detail

    def _on_kind(self, kind: Source) -> None:
        self._kind = kind

    def _on_frame(self, frame: CameraFrame) -> None:
        if self._down or self._last_s is None:
            self._down = ""
            self._pauses = delays(Random())  # noqa: S311
        self._last_s = self._clock()
        for on_frame in tuple(self.followers.values()):
            on_frame(frame)


class SharedSources:
    """All shared sources by their request."""

    def __init__(
        self,
        run: Run,
        clock: Callable[[], float] = robot_time,
        *,
        answered: Answered = lambda source_request: source_request,
    ) -> None:
        self._run = run
        self.answered = answered
        self._clock = clock
        self._shared_sources: dict[SourceRequest, SharedSource] = {}
        self._closing: set[asyncio.Future[None]] = set()
        # By topic, with the time at which each was seen.
        self._own_sizes: dict[str, tuple[tuple[int, int], float]] = {}

    def follow(self, source_request: SourceRequest, who: object, on_frame: OnFrame) -> SharedSource:
        """Give `who` all frames of a request from now on."""
        source_request = self.answered(source_request)
        shared = self._shared_sources.get(source_request)
        if shared is None:
            shared = self._shared_sources[source_request] = SharedSource(
                source_request, self._run, self._clock
            )
        shared.followers[who] = on_frame
        return shared

    def leave(self, shared: SharedSource, who: object) -> None:
        """Give no more; the last one to leave closes the source."""
        shared.followers.pop(who, None)
        if not shared.followers and self._shared_sources.get(shared.source_request) is shared:
            del self._shared_sources[shared.source_request]
            closing = shared.end()
            self._closing.add(closing)
            closing.add_done_callback(self._closing.discard)

    async def own_size(
        self, source_request: SourceRequest, within_s: float
    ) -> tuple[int, int] | None:
        """Return the camera's own width and height, whatever size is requested; None if it gives no JPEG in time."""
        topic, now_s = source_request.topic, self._clock()
        size, seen_s = self._own_sizes.get(topic, (None, -inf))
        if now_s - seen_s < SIZE_KEPT_S:
            return size
        whole = replace(source_request, quality=SIZE_QUALITY, width=None, height=None)
        with suppress(asyncio.TimeoutError):
            frame = await within(within_s, self._one_frame(whole))
            size = jpeg_size(frame.data) or size
        self._own_sizes.pop(topic, None)
        while len(self._own_sizes) >= MAX_SHARED_SOURCES:
            del self._own_sizes[next(iter(self._own_sizes))]
        if size is not None:
            self._own_sizes[topic] = size, now_s
        return size

    async def _one_frame(self, source_request: SourceRequest) -> CameraFrame:
        coming: asyncio.Future[CameraFrame] = asyncio.get_running_loop().create_future()

        def on_frame(frame: CameraFrame) -> None:
            if not coming.done():
                coming.set_result(frame)

        shared = self.follow(source_request, coming, on_frame)
        try:
            return await coming
        finally:
            self.leave(shared, coming)

    async def close(self) -> None:
        """Close all sources."""
        tasks = [*self._closing, *(shared.end() for shared in self._shared_sources.values())]
        self._shared_sources.clear()
        await asyncio.gather(*tasks, return_exceptions=True)


class SourceSwitch:
    """What one receiver follows; `on_frame` gets each frame and the request that it answers."""

    def __init__(
        self,
        shared_sources: SharedSources,
        on_frame: Callable[[CameraFrame, SourceRequest], None],
        clock: Callable[[], float],
    ) -> None:
        self._shared_sources = shared_sources
        self._on_frame = on_frame
        self._clock = clock
        self._shared: SharedSource | None = None
        self._next: SharedSource | None = None
        self._asked_s = 0.0
        self._last_s: float | None = None
        self._interval_s = 0.0

    @property
    def source_request(self) -> SourceRequest | None:
        """What the frames that come now answer."""
        return None if self._shared is None else self._shared.source_request

    def condition(self) -> VideoStatus:
        """Report how the source is."""
        if self._shared is None:
            return VideoStatus("waiting", source="web_video_server")
        return self._shared.condition()

    def follow(self, source_request: SourceRequest) -> None:
        """Go over to a request, as soon as there is a frame that answers it."""
        source_request = self._shared_sources.answered(source_request)
        if self._next is not None and self._next.source_request != source_request:
            self._drop_next()
        if self._shared is None:
            self._shared = self._shared_sources.follow(source_request, self, self._on_current)
        elif self._shared.source_request != source_request and self._next is None:
            self._asked_s = self._clock()
            self._next = self._shared_sources.follow(source_request, self, self._on_next)

    def give_up_late(self) -> bool:
        """Go on with the old source if the new one gave nothing for GIVE_UP_S; return whether that is so now."""
        if self._next is None or self._clock() - self._asked_s < GIVE_UP_S:
            return False
        if self._shared is not None and self._shared.condition().state != "live":
            # Neither gives anything: the newer request counts.
            self._go_over()
            return False
        self._drop_next()
        return True

    def leave(self) -> None:
        """Follow nothing."""
        self._drop_next()
        if self._shared is not None:
            self._shared_sources.leave(self._shared, self)
            self._shared = None

    def _drop_next(self) -> None:
        if self._next is not None:
            self._shared_sources.leave(self._next, self)
            self._next = None

    def _on_current(self, frame: CameraFrame) -> None:
        if self._shared is None or self._is_repeated(frame, 0.0):
            return
        self._hand_on(frame, self._shared.source_request)

    def _on_next(self, frame: CameraFrame) -> None:
        """Go over with the new source's first frame, which the old one may have given already."""
        if frame.codec.depends_on_earlier and not frame.is_key:
            return
        is_repeated = self._is_repeated(frame, SAME * self._interval_s)
        self._go_over()
        if self._shared is not None and not is_repeated:
            self._hand_on(frame, self._shared.source_request)

    def _is_repeated(self, frame: CameraFrame, margin_s: float) -> bool:
        """Whether what a frame shows was handed on already, and nothing depends on it."""
        if frame.codec.depends_on_earlier or self._last_s is None:
            return False
        return frame.timestamp_s - self._last_s < margin_s

    def _go_over(self) -> None:
        old, self._shared, self._next = self._shared, self._next, None
        if self._shared is not None:
            self._shared.followers[self] = self._on_current
        if old is not None:
            self._shared_sources.leave(old, self)

    def _hand_on(self, frame: CameraFrame, source_request: SourceRequest) -> None:
        if self._last_s is not None:
            passed_s = min(MAX_INTERVAL_S, frame.timestamp_s - self._last_s)
            self._interval_s += 0.2 * (passed_s - self._interval_s)
        self._last_s = frame.timestamp_s
        self._on_frame(frame, source_request)
