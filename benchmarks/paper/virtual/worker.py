"""A process of virtual robots, started by fleet.py in an uplink's namespace as `python -m paper.virtual.worker`.

Takes the orders of paper.fleet.worker, and tells what each robot's rosbridge was sent on the fleet's topic.
"""

from __future__ import annotations

import asyncio
import logging
import random
import time
from collections.abc import Mapping
from typing import Any

import uvloop
from robotether_agent.net.server_dialer import ServerDialer
from robotether_agent.net.tcp import Address, Resolver, resolve

from paper.fleet.worker import LOG_FORMAT, TOPIC, work
from paper.programs import write_line
from paper.virtual.robot import Account, VirtualRobot
from paper.virtual.services import Services

log = logging.getLogger(__name__)


class Numeric(Resolver):
    """Takes addresses only, which needs no thread for each connection."""

    async def addresses(self, host: str, port: int) -> list[Address]:
        return resolve(host, port)


class FleetRobot:
    """One robot; connected between `start` and `end`."""

    def __init__(self, name: str, settings: Mapping[str, str]) -> None:
        self._name = name
        account = Account.read(settings, ServerDialer(resolver=Numeric()))
        self._robot = VirtualRobot(account, Services(self._on_message), random.SystemRandom())
        self._running: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Nothing of it needs to be open."""

    async def close(self) -> None:
        await self.end()

    def start(self) -> None:
        self._running = asyncio.create_task(self._run())

    async def end(self) -> None:
        if self._running is not None:
            self._running.cancel()
            await asyncio.gather(self._running, return_exceptions=True)
            self._running = None

    async def _run(self) -> None:
        try:
            await self._robot.run()
        except Exception as error:
            # The border of a robot: the others go on.
            log.exception("the virtual robot %s ended", self._name)
            write_line({"robot": self._name, "failed": repr(error)})

    def _on_message(self, topic: str, message: Any) -> None:
        if topic == TOPIC:
            at_ns = time.monotonic_ns()
            write_line({"robot": self._name, "got": message["data"], "at_ns": at_ns})


def main() -> None:
    logging.basicConfig(level=logging.WARNING, format=LOG_FORMAT)
    # It tells each login, and makes a text of each packet for it.
    logging.getLogger("asyncssh").setLevel(logging.ERROR)
    uvloop.run(work(FleetRobot))


if __name__ == "__main__":
    main()
