"""Puts the simulated robot together: graph, robot, camera, both servers and the loop.

Started by __main__.py, and by tests on free ports.
"""

import asyncio
import contextlib
import time
from types import TracebackType
from typing import Self

from sim_robot.bus import Node
from sim_robot.camera import Scene
from sim_robot.frames import FrameFeed
from sim_robot.graph import make_graph
from sim_robot.kinematics import STEP_S
from sim_robot.rate import FixedRate
from sim_robot.robot import Robot
from sim_robot.rosbridge import rosapi
from sim_robot.rosbridge.server import RosbridgeServer
from sim_robot.settings import Settings
from sim_robot.video_server import TOPIC, VideoServer

CAMERA_NODE = Node("/camera")


class Simulator:
    """One whole simulated robot; `async with` starts and stops it."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.graph = make_graph(settings.ros_version)
        self.robot = Robot(self.graph, settings.world_size_m)
        self.feed = FrameFeed(self._look, settings.camera_fps)
        self.rate = FixedRate(STEP_S, self.robot.step)
        self.rosbridge = RosbridgeServer(self.graph)
        self.video = VideoServer(self.feed)
        self._loop_task: asyncio.Task[None] | None = None
        rosapi.offer(self.graph)
        # Listed for clients that look for cameras; its images go through the video server alone.
        self.graph.bus.advertise(TOPIC, "sensor_msgs/Image", CAMERA_NODE)

    async def start(self) -> None:
        """Listen and move."""
        settings = self._settings
        await self.rosbridge.listener.start(settings.bind_address, settings.rosbridge_port)
        await self.video.listener.start(settings.bind_address, settings.video_port)
        self._loop_task = asyncio.create_task(self.rate.run())

    async def wait(self) -> None:
        """Wait until the loop ends, which it does only by a fault or by `stop`."""
        if self._loop_task is not None:
            await self._loop_task

    async def stop(self) -> None:
        """End everything; what is under way gets about a second."""
        if self._loop_task is not None:
            self._loop_task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._loop_task
        await asyncio.gather(self.rosbridge.listener.stop(), self.video.listener.stop())
        await self.feed.close()

    async def __aenter__(self) -> Self:
        try:
            await self.start()
        except OSError:
            await self.stop()
            raise
        return self

    async def __aexit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:
        await self.stop()

    def _look(self) -> Scene:
        return Scene(
            name=self._settings.name,
            world_size_m=self._settings.world_size_m,
            pose=self.robot.turtle.pose,
            velocity=self.robot.turtle.velocity,
            path=tuple(self.robot.path),
            sim_time_s=self.robot.steps * STEP_S,
            stamp_ns=time.time_ns(),
        )
