"""A robot's ROS side without a robot: the simulator's rosbridge and bus alone, with no camera, sensor and motion.

Started as `python -m paper.bus_robot ADDRESS PORT` for experiments that count or time messages; idle it
does nothing. Stands in for ROS and rosbridge, as the simulator does. Ends on SIGTERM.
"""

from __future__ import annotations

import asyncio
import signal
import sys

from sim_robot.graph import Graph, make_graph
from sim_robot.rosbridge import rosapi
from sim_robot.rosbridge.server import RosbridgeServer
from sim_robot.simulator import Listener


class BusRobot:
    """rosbridge on an address; `async with` starts and stops it."""

    def __init__(self, address: str, port: int) -> None:
        self.graph: Graph = make_graph(2)
        self._address, self._port = address, port
        rosapi.offer(self.graph)
        self.rosbridge = Listener("rosbridge", RosbridgeServer(self.graph).app)

    async def __aenter__(self) -> BusRobot:
        await self.rosbridge.start(self._address, self._port)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.rosbridge.stop()


async def run(address: str, port: int) -> None:
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)
    async with BusRobot(address, port):
        await stopping.wait()


if __name__ == "__main__":
    asyncio.run(run(sys.argv[1], int(sys.argv[2])))
