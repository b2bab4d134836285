"""Follows one camera while what is wished of it changes: the new source is open before the old one ends.

Each picture that goes on is newer than the last, none is shown twice. A new source that gives nothing is let go after
a while, and the old one goes on.
"""

from __future__ import annotations

from collections.abc import Callable

from robotether_agent.media.feeds import Condition, Feed, Feeds
from robotether_agent.media.picture import Picture, Wish

GIVE_UP_S = 5.0
# Of the time between two pictures: what comes sooner after the last one, of another source, is the same one again.
SAME = 0.5
INTERVAL_MAX_S = 1.0


class Switch:
    """What one receiver follows; `take` gets each picture and the wish that it answers."""

    def __init__(
        self, feeds: Feeds, take: Callable[[Picture, Wish], None], clock: Callable[[], float]
    ) -> None:
        self._feeds = feeds
        self._take = take
        self._clock = clock
        self._feed: Feed | None = None
        self._next: Feed | None = None
        self._asked_s = 0.0
        self._last_s: float | None = None
        self._interval_s = 0.0

    @property
    def wish(self) -> Wish | None:
        """What the pictures that come now answer."""
        return None if self._feed is None else self._feed.wish

    def condition(self) -> Condition:
        """Tell how the source is."""
        return Condition() if self._feed is None else self._feed.condition()

    def follow(self, wish: Wish) -> None:
        """Go over to a wish, as soon as there is a picture that answers it."""
        if self._next is not None and self._next.wish != wish:
            self._drop_next()
        if self._feed is None:
            self._feed = self._feeds.follow(wish, self, self._came)
        elif self._feed.wish != wish and self._next is None:
            self._asked_s = self._clock()
            self._next = self._feeds.follow(wish, self, self._came_anew)

    def give_up_late(self) -> bool:
        """Go on with the old source if the new one gave nothing for GIVE_UP_S; tell whether that is so now."""
        if self._next is None or self._clock() - self._asked_s < GIVE_UP_S:
            return False
        if self._feed is not None and self._feed.condition().state != "live":
            # Neither gives anything: the newer wish counts.
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

    def _came(self, picture: Picture) -> None:
        if self._feed is None or (self._last_s is not None and picture.moment_s < self._last_s):
            return
        self._hand_on(picture, self._feed.wish)

    def _came_anew(self, picture: Picture) -> None:
        """Go over with the new source's first picture, which the old one may have given already."""
        is_same = (
            self._last_s is not None and picture.moment_s - self._last_s < SAME * self._interval_s
        )
        self._go_over()
        if self._feed is not None and not is_same:
            self._hand_on(picture, self._feed.wish)

    def _go_over(self) -> None:
        old, self._feed, self._next = self._feed, self._next, None
        if self._feed is not None:
            self._feed.followers[self] = self._came
        if old is not None:
            self._feeds.leave(old, self)

    def _hand_on(self, picture: Picture, wish: Wish) -> None:
        if self._last_s is not None:
            passed_s = min(INTERVAL_MAX_S, picture.moment_s - self._last_s)
            self._interval_s += 0.2 * (passed_s - self._interval_s)
        self._last_s = picture.moment_s
        self._take(picture, wish)
