"""A process of virtual robots, started by fleet.py in an uplink's namespace as `python -m paper.virtual.worker`.

Takes the orders of paper.fleet.worker, and tells what each robot's rosbridge was sent on the fleet's topic.
"""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Mapping
from typing import Any

import uvloop
from robotether_agent.net.server_dialer import ServerDialer
from robotether_agent.net.tcp import Address, Resolver, resolve

from paper.fleet.worker import LOG_FORMAT, TOPIC, Robot, work
from paper.programs import write_line
from paper.virtual.robot import Account, VirtualRobot
from paper.virtual.services import Services


class Numeric(Resolver):
    """Takes addresses only, which needs no thread for each connection."""

    async def addresses(self, host: str, port: int) -> list[Address]:
        return resolve(host, port)


class FleetRobot(Robot):
    """One robot."""

    def __init__(self, name: str, settings: Mapping[str, str]) -> None:
        super().__init__(name)
        account = Account.read(settings, ServerDialer(resolver=Numeric()))
        self._robot = VirtualRobot(account, Services(self._on_message), random.SystemRandom())

    async def open(self) -> None:
        """Nothing of it needs to be open."""

    async def play(self) -> None:
        await self._robot.run()

    def _on_message(self, topic: str, message: Any) -> None:
        if topic == TOPIC:
            at_ns = time.monotonic_ns()
            write_line({"robot": self.name, "got": message["data"], "at_ns": at_ns})


def main() -> None:
    logging.basicConfig(level=logging.WARNING, format=LOG_FORMAT)
    # It tells each login, and makes a text of each packet for it.
    logging.getLogger("asyncssh").setLevel(logging.ERROR)
    uvloop.run(work(FleetRobot))


if __name__ == "__main__":
    main()
