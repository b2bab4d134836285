"""A robot's ROS side without a robot: the simulator's rosbridge and bus alone, with no camera, sensor and motion.

Started as `python -m paper.bus_robot ADDRESS PORT`; idle it does nothing. Ends on SIGTERM. With CLOUD behind the port
it publishes a large message of a lidar each second, too, while somebody subscribes.
"""

from __future__ import annotations

import asyncio
import base64
import os
import signal
import sys
import time

from sim_robot.graph import Graph, Node, TopicMessage, make_graph
from sim_robot.rosbridge import rosapi
from sim_robot.rosbridge.server import RosbridgeServer
from sim_robot.simulator import Listener

CLOUD, CLOUD_TYPE, CLOUD_HZ = "/points", "sensor_msgs/PointCloud2", 1
# 128 lines of a lidar, each of 2670 points with place and intensity; 7.3 MB as rosbridge writes them.
LINES, POINTS_A_LINE, POINT_BYTES = 128, 2670, 16


class BusRobot:
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


async def publish_clouds(graph: Graph) -> None:
    """Publish until this is cancelled; what the points are is of no matter."""
    graph.bus.advertise(CLOUD, CLOUD_TYPE, Node("/lidar"))
    data = base64.b64encode(os.urandom(LINES * POINTS_A_LINE * POINT_BYTES)).decode()
    given = {
        "height": LINES,
        "width": POINTS_A_LINE,
        "point_step": POINT_BYTES,
        "row_step": POINTS_A_LINE * POINT_BYTES,
        "data": data,
        "is_dense": True,
    }
    # One message: to encode it each time would keep this process, which echoes what drivers send, busy for 20 ms.
    values = graph.types.conform(CLOUD_TYPE, given, time.time_ns())
    cloud = TopicMessage(CLOUD, CLOUD_TYPE, values)
    while True:
        await asyncio.sleep(1 / CLOUD_HZ)
        graph.bus.repeat(cloud)


async def run(address: str, port: int, *, with_cloud: bool) -> None:
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)
    async with BusRobot(address, port) as robot:
        clouds = asyncio.create_task(publish_clouds(robot.graph)) if with_cloud else None
        await stopping.wait()
        if clouds is not None:
            clouds.cancel()
            await asyncio.gather(clouds, return_exceptions=True)


if __name__ == "__main__":
    asyncio.run(run(sys.argv[1], int(sys.argv[2]), with_cloud="CLOUD" in sys.argv[3:]))
