"""The newest snapshot of robots and rights, kept in memory and read again when they change.

`wiring` runs it. While the database is away the relay works with the last snapshot; the log says so
once, and the metrics all the time.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Protocol

from robotether_server.db.control import StoredControl
from robotether_server.db.fleet import Changes, RelayRequest, Snapshot
from robotether_server.db.routes import RelayRoute
from robotether_server.problems import StoreError, StoreUnavailableError
from robotether_server.relay.records.database import RelayDatabase

log = logging.getLogger(__name__)

POLL_EVERY_S = 1.0
# Interval between rechecks of credentials, whose expiry changes nothing in the database.
RECHECK_EVERY_S = 30.0


# A robot's id, when it was last seen, and why its session ended.
LastSeen = tuple[int, datetime, str | None]
# Takes robots' open requests for help; None: the database is away, and they are unknown.
HelpListener = Callable[[Sequence[RelayRequest] | None], None]


class PolledCredentials(Protocol):
    """The log-ins and tokens in use, which end when the database says so."""

    async def recheck(self, *, changed: bool = True) -> None:
        """Ask for all of them again."""

    async def check_new(self) -> None:
        """Ask for those that came since."""


class Fleet:
    """Polls the database, and notifies listeners when robots or rights changed."""

    def __init__(
        self,
        database: RelayDatabase,
        credentials: PolledCredentials,
        *,
        poll_every_s: float = POLL_EVERY_S,
    ) -> None:
        self._database = database
        self._credentials = credentials
        self._listeners: list[Callable[[Snapshot], None]] = []
        # Are notified of robots' open requests for help, at each poll; must not block.
        self.help_listeners: tuple[HelpListener, ...] = ()
        # Gets the routes that last, after each poll; robots and rights are then no older.
        self.on_routes: Callable[[Sequence[RelayRoute]], None] = _ignore
        # Get what outlived the relay before this one, before anybody is served.
        self.restore_last_seen: Callable[[list[LastSeen]], None] = _ignore
        self.restore_control: Callable[[StoredControl], None] = _ignore
        self._poll_every_s = poll_every_s
        self._snapshot: Snapshot | None = None
        self._changes: Changes | None = None
        self._rechecked_at = 0.0
        self._polling = asyncio.Lock()
        self.store_up = True
        # Robots' open requests for help, as they were last read.
        self._help_requests: Sequence[RelayRequest] = ()

    def listen(self, *listeners: Callable[[Snapshot], None]) -> None:
        """Notify these, in order, when robots or rights changed; they must not block."""
        self._listeners.extend(listeners)

    def snapshot(self) -> Snapshot:
        """The last snapshot; StoreUnavailableError as long as there has never been one."""
        if self._snapshot is None:
            raise StoreUnavailableError(
                "cannot answer: the database has not answered the relay yet; try again shortly"
            )
        return self._snapshot

    def state(self) -> Snapshot:
        """The last snapshot, or an empty one."""
        return self._snapshot or Snapshot(robots={}, grants={})

    def known_help_requests(self) -> Sequence[RelayRequest] | None:
        """Return robots' open requests for help; None: the database is away, and they are unknown."""
        return self._help_requests if self.store_up else None

    def region_of(self, robot_id: int) -> str | None:
        """Return the region of a robot; None: it has none, or is not known."""
        robot = self.state().robots.get(robot_id)
        return None if robot is None else robot.settings.region

    async def run(self) -> None:
        """Poll for ever."""
        while True:
            await self.poll()
            await asyncio.sleep(self._poll_every_s)

    async def poll(self) -> None:
        """Ask once whether anything changed, and take it over."""
        try:
            async with self._polling:
                await self._poll_changes()
                await self._poll_help_requests()
        except StoreError as problem:
            self._set_store_up(False, problem.detail)
            self._notify_of_help(None)
        except Exception:
            # Whatever one poll met, the next may succeed; without polls rights would never end.
            log.exception("cannot read robots and rights; the last known ones stay in force")
            self.store_up = False
            self._notify_of_help(None)
        else:
            self._set_store_up(True)

    async def _poll_changes(self) -> None:
        before, now = self._changes, await self._database.changes()
        if self._snapshot is None or self._snapshot.rights != now.rights:
            if self._snapshot is None:
                await self._restore()
            self._snapshot = await self._database.load()
            for listener in self._listeners:
                listener(self._snapshot)
        self.on_routes(now.routes)
        time = asyncio.get_running_loop().time()
        changed = before is None or before.credentials != now.credentials
        if changed or time - self._rechecked_at > RECHECK_EVERY_S:
            await self._credentials.recheck(changed=changed)
            self._rechecked_at = time
        else:
            await self._credentials.check_new()
        self._changes = now

    async def _poll_help_requests(self) -> None:
        self._help_requests = await self._database.help_requests()
        self._notify_of_help(self._help_requests)

    def _notify_of_help(self, requests: Sequence[RelayRequest] | None) -> None:
        for listener in self.help_listeners:
            listener(requests)

    async def _restore(self) -> None:
        self.restore_last_seen(await self._database.last_seen())
        # A robot that is stopped stays so, and numbers go on.
        self.restore_control(await self._database.stored_control())

    def _set_store_up(self, up: bool, why: str = "") -> None:
        if up and not self.store_up:
            log.warning("the database answers again")
        elif not up and self.store_up:
            log.warning("%s; robots and rights stay as they were last read", why)
        self.store_up = up


def _ignore(_stored: object) -> None:
    """Take nothing over."""
