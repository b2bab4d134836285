"""The relay's own operations on the rosbridge WebSocket: clock syncs, the control object, and the stop.

Each bridge has one. Only a client that sends clock syncs gets any of these, so that other rosbridge clients never
see them. None reaches a robot, and none waits for the database. What comes from a robot passes unread, so a robot can
write the same operations: the key in a client's clock syncs, which no robot sees, shows which ones are the relay's.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.control.control import Control


class OwnOperations:
    """What one connection may ask of the relay itself."""

    def __init__(self, control: Control, robot: RelayRobot, user: str, address: str | None) -> None:
        self._control = control
        self._robot = robot
        self._user = user
        self._address = address
        self._clock_syncs = False
        self._key: dict[str, object] = {}
        self._update_due = asyncio.Event()

    def watched(self) -> AbstractContextManager[None]:
        """Hear of changes inside the block."""
        return self._control.watched(self._robot.id, self._changed)

    def answer(self, operation: str, own: Mapping[str, Any]) -> bytes | None:
        """Do what the client asks; return the answer."""
        if operation == "robotether.stop":
            self._control.stops.stop(self._robot, self._user, address=self._address)
            return None
        self._key = {"key": own["key"]} if "key" in own else {}
        if not self._clock_syncs:
            self._clock_syncs = True
            self._update_due.set()
        relay_ms = round(time.monotonic() * 1000, 3)
        return _written(operation, t_ms=own.get("t_ms"), relay_ms=relay_ms, **self._key)

    async def next_update(self) -> bytes:
        """Wait until there is something to tell; return the control object's message."""
        await self._update_due.wait()
        self._update_due.clear()
        control = self._control.describe(self._robot.id)
        return _written("robotether.control", control=control, **self._key)

    def _changed(self) -> None:
        if self._clock_syncs:
            self._update_due.set()


def _written(operation: str, **members: object) -> bytes:
    return json.dumps({"op": operation, **members}, separators=(",", ":")).encode()
