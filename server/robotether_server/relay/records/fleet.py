"""The newest snapshot of robots and rights, kept in memory and read again when they change.

`main` runs it. While the database is away everything goes on with the last snapshot; the log says
so once, and the metrics all the time.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from datetime import datetime

from robotether_server.db.control import StoredControl
from robotether_server.db.fleet import Changes, Snapshot
from robotether_server.problems import StoreProblem, StoreUnavailable
from robotether_server.relay.records.database import RelayDatabase

log = logging.getLogger(__name__)

POLL_EVERY_S = 1.0
# Credentials also end by time, which changes nothing in the database.
RECHECK_EVERY_S = 30.0


class Fleet:
    """Polls the database; calls back when rights or credentials changed."""

    def __init__(
        self,
        database: RelayDatabase,
        *,
        rights_changed: Callable[[Snapshot], None],
        credentials_changed: Callable[[], Awaitable[None]],
        check_new_credentials: Callable[[], Awaitable[None]],
        last_seen: Callable[[list[tuple[int, datetime, str | None]]], None],
        on_stored_control: Callable[[StoredControl], None],
        poll_every_s: float = POLL_EVERY_S,
    ) -> None:
        self._database = database
        self._rights_changed = rights_changed
        self._credentials_changed = credentials_changed
        self._check_new_credentials = check_new_credentials
        self._last_seen = last_seen
        self._on_stored_control = on_stored_control
        self._poll_every_s = poll_every_s
        self._snapshot: Snapshot | None = None
        self._changes: Changes | None = None
        self._rechecked_at = 0.0
        self._polling = asyncio.Lock()
        self.store_up = True

    @property
    def snapshot(self) -> Snapshot:
        """The last snapshot; StoreUnavailable as long as there has never been one."""
        if self._snapshot is None:
            raise StoreUnavailable(
                "cannot answer: the database has not answered the relay yet; try again shortly"
            )
        return self._snapshot

    @property
    def known(self) -> Snapshot:
        """The last snapshot, or an empty one."""
        return self._snapshot or Snapshot(robots={}, grants={})

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
        except StoreProblem as problem:
            self._set_store_up(False, problem.detail)
        except Exception:
            # Whatever one poll met, the next may succeed; without polls rights would never end.
            log.exception("cannot read robots and rights; the last known ones stay in force")
            self.store_up = False
        else:
            self._set_store_up(True)

    async def _poll_changes(self) -> None:
        before, now = self._changes, await self._database.changes()
        if self._snapshot is None or self._snapshot.rights != now.rights:
            if self._snapshot is None:
                self._last_seen(await self._database.last_seen())
                # Before anybody is served: a robot that is stopped stays so, and numbers go on.
                self._on_stored_control(await self._database.stored_control())
            self._snapshot = await self._database.load()
            self._rights_changed(self._snapshot)
        time = asyncio.get_running_loop().time()
        overdue = time - self._rechecked_at > RECHECK_EVERY_S
        if overdue or before is None or before.credentials != now.credentials:
            await self._credentials_changed()
            self._rechecked_at = time
        else:
            await self._check_new_credentials()
        self._changes = now

    def _set_store_up(self, up: bool, why: str = "") -> None:
        if up and not self.store_up:
            log.warning("the database answers again")
        elif not up and self.store_up:
            log.warning("%s; robots and rights stay as they were last read", why)
        self.store_up = up
