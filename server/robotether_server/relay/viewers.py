"""What all who watch a robot's cameras have in common: room, rights, and which picture comes next.

`video`, `streams` and `frames` let their viewers in here. Each is cut when its link, right or login ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from aiohttp import web

from robotether_server.problems import FieldInvalid
from robotether_server.relay import endings
from robotether_server.relay.access import Permit
from robotether_server.relay.connections import Connection
from robotether_server.relay.endings import Ending
from robotether_server.relay.feeds import Feed
from robotether_server.relay.means import Means
from robotether_server.relay.pictures import Picture

MAX_TOPIC = 255


def connection_of(permit: Permit, camera: str, end: Callable[[Ending], None]) -> Connection:
    """Return the connection that a viewer of this camera counts as; no camera: an empty text."""
    return Connection(
        permit.user.id,
        permit.user.name,
        permit.robot,
        "video",
        end,
        level=permit.level,
        reached=True,
        camera=camera,
        may_drive=permit.may_drive,
    )


@contextmanager
def counted(means: Means, permit: Permit, connection: Connection) -> Iterator[None]:
    """Count a viewer inside the block, and have it ended when it may see no more."""
    gone = partial(connection.end, endings.rights_ended(permit.robot.name))
    with means.connections.joined(connection), means.credentials.held(permit.credential, gone):
        yield


class Cursor:
    """Which picture of a feed one viewer gets next: the newest, if it has not had it."""

    def __init__(self, feed: Feed, now_s: float) -> None:
        self._feed = feed
        self._last = feed.newest
        # What came before the viewer did; what is fresh is shown at once.
        self._shown = self._last is None or not feed.fresh(now_s)
        if self._last is not None and self._shown:
            feed.taken(self._last.number)

    def next(self) -> Picture | None:
        """Return the picture that the viewer gets next, None when it has had the newest."""
        newest = self._feed.newest
        return None if newest is self._last and self._shown else newest

    def sent(self, picture: Picture) -> None:
        """The viewer was sent the picture."""
        before = picture.place if self._last is None else self._last.place + self._shown
        self._feed.sent(picture, max(0, picture.place - before))
        self._last, self._shown = picture, True


def topic_of(request: web.Request) -> str:
    """Return which camera is asked for; FieldInvalid when none is."""
    topic: str = request.query.get("topic", "")
    if not 0 < len(topic) <= MAX_TOPIC or not topic.isprintable():
        raise FieldInvalid(
            f"cannot open a camera: name it with topic=, in at most {MAX_TOPIC} characters"
        )
    return topic
