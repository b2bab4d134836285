"""Follows one camera while what is wished of it changes: the new source is open before the old one ends.

Each frame that goes on is newer than the last, none is shown twice. A new source that gives nothing is let go after
a while, and the old one goes on.
"""

from __future__ import annotations

from collections.abc import Callable

from robotether_agent.video.feeds import Condition, Feed, Feeds
from robotether_agent.video.frame import Frame, SourceRequest

GIVE_UP_S = 5.0
# Of the time between two frames: what comes sooner after the last one, of another source, is the same one again.
SAME = 0.5
MAX_INTERVAL_S = 1.0


class SourceSwitch:
    """What one receiver follows; `on_frame` gets each frame and the request that it answers."""

    def __init__(
        self,
        feeds: Feeds,
        on_frame: Callable[[Frame, SourceRequest], None],
        clock: Callable[[], float],
    ) -> None:
        self._feeds = feeds
        self._on_frame = on_frame
        self._clock = clock
        self._feed: Feed | None = None
        self._next: Feed | None = None
        self._asked_s = 0.0
        self._last_s: float | None = None
        self._interval_s = 0.0

    @property
    def source_request(self) -> SourceRequest | None:
        """What the frames that come now answer."""
        return None if self._feed is None else self._feed.source_request

    def condition(self) -> Condition:
        """Tell how the source is."""
        return Condition() if self._feed is None else self._feed.condition()

    def follow(self, source_request: SourceRequest) -> None:
        """Go over to a request, as soon as there is a frame that answers it."""
        if self._next is not None and self._next.source_request != source_request:
            self._drop_next()
        if self._feed is None:
            self._feed = self._feeds.follow(source_request, self, self._on_current)
        elif self._feed.source_request != source_request and self._next is None:
            self._asked_s = self._clock()
            self._next = self._feeds.follow(source_request, self, self._on_next)

    def give_up_late(self) -> bool:
        """Go on with the old source if the new one gave nothing for GIVE_UP_S; tell whether that is so now."""
        if self._next is None or self._clock() - self._asked_s < GIVE_UP_S:
            return False
        if self._feed is not None and self._feed.condition().state != "live":
            # Neither gives anything: the newer request counts.
            self._go_over()
            return False
        self._drop_next()
        return True

    def leave(self) -> None:
        """Follow nothing."""
        self._drop_next()
        if self._feed is not None:
            self._feeds.leave(self._feed, self)
            self._feed = None

    def _drop_next(self) -> None:
        if self._next is not None:
            self._feeds.leave(self._next, self)
            self._next = None

    def _on_current(self, frame: Frame) -> None:
        if self._feed is None or (self._last_s is not None and frame.timestamp_s < self._last_s):
            return
        self._hand_on(frame, self._feed.source_request)

    def _on_next(self, frame: Frame) -> None:
        """Go over with the new source's first frame, which the old one may have given already."""
        is_same = (
            self._last_s is not None and frame.timestamp_s - self._last_s < SAME * self._interval_s
        )
        self._go_over()
        if self._feed is not None and not is_same:
            self._hand_on(frame, self._feed.source_request)

    def _go_over(self) -> None:
        old, self._feed, self._next = self._feed, self._next, None
        if self._feed is not None:
            self._feed.followers[self] = self._on_current
        if old is not None:
            self._feeds.leave(old, self)

    def _hand_on(self, frame: Frame, source_request: SourceRequest) -> None:
        if self._last_s is not None:
            passed_s = min(MAX_INTERVAL_S, frame.timestamp_s - self._last_s)
            self._interval_s += 0.2 * (passed_s - self._interval_s)
        self._last_s = frame.timestamp_s
        self._on_frame(frame, source_request)
