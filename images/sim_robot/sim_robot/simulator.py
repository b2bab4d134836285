"""Puts the simulated robot together: graph, robot, cameras, sensors, devices, both servers and the loop.

Started by __main__.py, and by tests on free ports.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable
from functools import partial
from types import TracebackType
from typing import Self

from aiohttp import web

from sim_robot import devices
from sim_robot.camera import ABOVE, AHEAD, AROUND, CompressedCamera, FrameFeed, FrameFormat, Scene
from sim_robot.camera import NODE as CAMERA_NODE
from sim_robot.devices import Devices, Sensors
from sim_robot.graph import make_graph
from sim_robot.kinematics import STEP_S
from sim_robot.robot import RobotNode
from sim_robot.rosbridge import rosapi
from sim_robot.rosbridge.server import RosbridgeServer
from sim_robot.settings import SimSettings
from sim_robot.transforms import LASERS, TF_HZ, Transforms
from sim_robot.video_server import VideoServer
from sim_robot.world import World

log = logging.getLogger(__name__)

LATE_LIMIT_S = 0.25
WARN_EVERY_S = 10.0
SHUTDOWN_TIMEOUT_S = 1.0
CAMERAS = {"/camera/image_raw": AHEAD, "/rear/image_raw": ABOVE, "/turret/image_raw": AROUND}
# Drivers differ: some publish reliably, some with the QoS of sensors.
BEST_EFFORT = ("/rear/image_raw",)


class Listener:
    """Starts and stops an application; after the start `port` is the real one, also for port 0."""

    def __init__(self, name: str, app: web.Application) -> None:
        self._name = name
        self._runner = web.AppRunner(
            app, access_log=None, handle_signals=False, shutdown_timeout=SHUTDOWN_TIMEOUT_S
        )
        self.port = 0

    async def start(self, address: str, port: int) -> None:
        """Listen; OSError if the port is taken."""
        await self._runner.setup()
        await web.TCPSite(self._runner, address, port).start()
        self.port = self._runner.addresses[0][1]
        log.info("%s listens on %s:%d", self._name, address, self.port)

    async def stop(self) -> None:
        """End all connections."""
        await self._runner.cleanup()


class FixedRate:
    """Calls `action` every `period_s` seconds until its task is cancelled, and says so when it cannot.

    Deadlines are multiples of the period from the start, so that a late call does not move the following ones; missed
    calls are made up, up to a limit.
    """

    def __init__(self, period_s: float, action: Callable[[], None]) -> None:
        self._period_s = period_s
        self._action = action
        self.skipped = 0

    async def run(self) -> None:
        """Run for ever."""
        loop = asyncio.get_running_loop()
        deadline_s = loop.time()
        warn_at_s = deadline_s
        while True:
            deadline_s += self._period_s
            # Also when late: others get their turn between two calls that are made up.
            await asyncio.sleep(max(deadline_s - loop.time(), 0.0))
            late_s = loop.time() - deadline_s
            if late_s > LATE_LIMIT_S:
                deadline_s += self._skip(late_s)
                if loop.time() >= warn_at_s:
                    warn_at_s = loop.time() + WARN_EVERY_S
                    self._warn(late_s)
            self._action()

    def _skip(self, late_s: float) -> float:
        missed = int(late_s / self._period_s)
        self.skipped += missed
        return missed * self._period_s

    def _warn(self, late_s: float) -> None:
        log.warning(
            "cannot hold %.1f Hz: was %.0f ms late, %d steps skipped since the start;"
            " give this robot more processor time",
            1 / self._period_s,
            late_s * 1000,
            self.skipped,
        )


class Simulator:
    """One whole simulated robot; `async with` starts and stops it."""

    def __init__(self, settings: SimSettings) -> None:
        self._settings = settings
        self.graph = make_graph(settings.ros_version)
        self.robot = RobotNode(self.graph, settings.world_size_m, settings.kind)
        width, height = map(int, settings.camera_size.split("x"))
        own_format = FrameFormat(width, height)
        self.feeds = {
            topic: FrameFeed(partial(self._scene, camera), settings.camera_fps, own_format)
            for topic, camera in list(CAMERAS.items())[: settings.cameras]
        }
        self.devices = Devices(self.graph, self.robot, tuple(self.feeds.values()))
        laser = LASERS[settings.kind]
        self._sensors = Sensors(self.graph, self.robot, World(settings.world_size_m), laser)
        self._transforms = Transforms(self.graph, self.robot, laser)
        self._compressed = [CompressedCamera(self.graph, *camera) for camera in self.feeds.items()]
        self._slower = (
            (_steps(devices.STEP_S), self.devices.step),
            (_steps(1 / devices.SCAN_HZ), self._sensors.step),
            (_steps(1 / TF_HZ), self._transforms.step),
        )
        self.rate = FixedRate(STEP_S, self._step)
        self.rosbridge = Listener("rosbridge", RosbridgeServer(self.graph).app)
        best_effort = BEST_EFFORT if settings.ros_version == 2 else ()  # noqa: PLR2004
        self.video = Listener("video", VideoServer(self.feeds, best_effort).app)
        self._loop_task: asyncio.Task[None] | None = None
        rosapi.offer(self.graph)
        # Listed for clients that look for cameras; their images go through the video server or a CompressedCamera.
        for topic in self.feeds:
            self.graph.bus.advertise(topic, "sensor_msgs/Image", CAMERA_NODE)

    async def start(self) -> None:
        """Listen and move."""
        settings = self._settings
        await self.rosbridge.start(settings.bind_address, settings.rosbridge_port)
        await self.video.start(settings.bind_address, settings.video_port)
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
        # A frozen camera would keep those waiting who end now.
        for feed in self.feeds.values():
            feed.freeze(False)
        await asyncio.gather(self.rosbridge.stop(), self.video.stop())
        await asyncio.gather(*(camera.close() for camera in self._compressed))
        await asyncio.gather(*(feed.close() for feed in self.feeds.values()))

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

    def _step(self) -> None:
        self.robot.step()
        for topic in self._compressed:
            topic.step()
        for steps, action in self._slower:
            if self.robot.steps % steps == 0:
                action()

    def _scene(self, camera: str) -> Scene:
        return Scene(
            name=self._settings.name,
            world_size_m=self._settings.world_size_m,
            pose=self.robot.turtle.pose,
            velocity=self.robot.turtle.velocity,
            path=tuple(self.robot.path),
            sim_time_s=self.robot.steps * STEP_S,
            stamp_ns=time.time_ns(),
            camera=camera,
        )


def _steps(period_s: float) -> int:
    return round(period_s / STEP_S)
