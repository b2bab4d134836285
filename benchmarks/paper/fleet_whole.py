"""Robots as they are in the field, for a small fleet: agent, guard and rosbridge are processes of their own.

Beside the light robots they show what those leave out: the start of two Pythons a robot is in the time, and the guard
is a process of its own. The robots' rosbridges run before the clock starts.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from typing import Any, TypeVar

import aiohttp

from paper.fleet import Fleet, OnMessage, following, robots_of, shares
from paper.fleet_worker import TOPIC, TYPE
from paper.operator import connector
from paper.profiles import PLAIN
from paper.robots import WholeRobot
from paper.world import World

ROSBRIDGE_WITHIN_S, TRY_AGAIN_S = 30.0, 0.1
T = TypeVar("T")


class WholeRobots:
    """Robots behind their uplinks; a Side of a fleet."""

    def __init__(self, robots: Sequence[WholeRobot]) -> None:
        self.on_message: OnMessage = lambda _: None
        self._robots = robots
        self._are_started = False

    @property
    def pids(self) -> Sequence[int]:
        """The processes now."""
        rosbridges = [robot.ros_pid for robot in self._robots]
        agents = [robot.agent_pid for robot in self._robots] if self._are_started else []
        return rosbridges + agents

    async def do(self, order: str, within_s: float) -> None:
        """Start or end all agents; each end is bounded already."""
        del within_s
        if order == "start":
            for robot in self._robots:
                robot.start_agent()
            self._are_started = True
        else:
            for robot in self._robots:
                robot.ask_agent_to_end()
            await asyncio.to_thread(self._end)

    def log_tail(self) -> str:
        """What those said last that have ended."""
        return "\n".join(robot.logs() for robot in self._robots if robot.ended())

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[None]:
        """Subscribe at each robot's own rosbridge, and tell what comes."""
        async with AsyncExitStack() as stack:
            sockets = [await self._subscribed(stack, robot) for robot in self._robots]
            tasks = [
                asyncio.ensure_future(self._listen(robot.name, socket))
                for robot, socket in zip(self._robots, sockets, strict=True)
            ]
            try:
                yield
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)

    async def _subscribed(
        self, stack: AsyncExitStack, robot: WholeRobot
    ) -> aiohttp.ClientWebSocketResponse:
        http = aiohttp.ClientSession(connector=connector(robot.uplink))
        await stack.enter_async_context(http)
        socket = await stack.enter_async_context(await _rosbridge(http, robot))
        await socket.send_json({"op": "subscribe", "topic": TOPIC, "type": TYPE})
        return socket

    async def _listen(self, robot: str, socket: aiohttp.ClientWebSocketResponse) -> None:
        async for frame in socket:
            at_ns = time.monotonic_ns()
            message: Mapping[str, Any] = json.loads(frame.data)
            if message.get("op") == "publish":
                self.on_message({"robot": robot, "got": message["msg"]["data"], "at_ns": at_ns})
        self.on_message(
            {"robot": robot, "failed": "its rosbridge closed the subscriber's connection"}
        )

    def _end(self) -> None:
        for robot in self._robots:
            robot.end_agent()


async def _rosbridge(
    http: aiohttp.ClientSession, robot: WholeRobot
) -> aiohttp.ClientWebSocketResponse:
    """Connect to a rosbridge that may be just starting."""
    end = time.monotonic() + ROSBRIDGE_WITHIN_S
    while True:
        try:
            return await http.ws_connect(robot.ros_url)
        except (aiohttp.ClientError, OSError) as error:
            if robot.ended() or time.monotonic() > end:
                raise RuntimeError(
                    f"{robot.name} has no rosbridge: {error}\n{robot.logs()}"
                ) from error
        await asyncio.sleep(TRY_AGAIN_S)


def with_whole_fleet(world: World, count: int, use: Callable[[Fleet], Awaitable[T]]) -> T:
    """What `use` returns of a fleet of `count` whole robots, whose agents have not started yet."""
    enrolled = robots_of(world, count)
    with world.uplinks([PLAIN] * len(shares(count))) as uplinks, ExitStack() as ending:
        places = [
            uplink
            for uplink, share in zip(uplinks, shares(count), strict=True)
            for _ in range(share)
        ]
        robots = [
            WholeRobot(world, *pair, "bus", aside=True)
            for pair in zip(enrolled, places, strict=True)
        ]
        for robot in robots:
            ending.push(robot)
            robot.start_ros()

        async def run() -> T:
            side = WholeRobots(robots)
            async with side.listening(), following(world, enrolled, [side]) as fleet:
                return await use(fleet)

        return asyncio.run(run())
