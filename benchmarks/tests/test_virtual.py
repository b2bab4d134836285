"""A virtual robot beside the real agent, at the same server: sshd and the relay cannot tell one from the other."""

from __future__ import annotations

import asyncio
import shutil
import tempfile
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import aiohttp
from fake_cameras import FakeVideoServer
from fake_cloud import agent_environ, eventually
from fake_robot import HOST
from fake_rosbridge import FakeRosbridge
from paper.virtual.robot import Account, VirtualRobot
from paper.virtual.services import Services
from recording_server import RecordingServer, running_agent
from relay_server import FAST, MemoryDatabase, RelayServer, running_relay
from robotether_agent import settings as agent_settings
from robotether_agent.enrolment.enroller import Enroller
from robotether_server.db.fleet import RelayUser

WAIT_S = 60.0
TWIST = {"linear": {"x": 0.5, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
MOVE = {"op": "publish", "topic": "/cmd_vel", "msg": TWIST}
TYPED = {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
# In the middle of a move, and what is measured.
VARIES = ("t_ms", "seq", "id", "answers", "epoch")
Robot = Callable[[RecordingServer, Path], AbstractAsyncContextManager[None]]


@asynccontextmanager
async def real_agent(server: RecordingServer, place: Path) -> AsyncIterator[None]:
    async with FakeRosbridge() as rosbridge, FakeVideoServer() as video:
        urls = {"rosbridge_url": f"ws://{HOST}:{rosbridge.port}", "video_url": video.url}
        async with running_agent(agent_environ(server, place, **urls)):
            yield


@asynccontextmanager
async def virtual_robot(server: RecordingServer, place: Path) -> AsyncIterator[None]:
    environ = agent_environ(server, place)
    await Enroller(agent_settings.load(None, environ)).join()
    account = {"server": environ["ROBOTETHER_SERVER"], "state_dir": environ["ROBOTETHER_STATE_DIR"]}
    services = Services()
    await services.start()
    robot = VirtualRobot(Account.read(account), services, Random(7))
    running = asyncio.ensure_future(robot.run())
    try:
        yield
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        services.close()


class Played:
    """A robot's life at a server of its own, from a return on."""

    def __init__(self, server: RecordingServer) -> None:
        self.server = server
        self.began = 0
        # What its port answers to a plain request, and the server to a stop and a release.
        self.statuses: list[int] = []

    def lines(self, who: str) -> list[dict[str, Any]]:
        """What one side said on its newest session."""
        said = self.server.said[self.began :]
        return [line for of, by, line in said if (of, by) == ("session", who)]

    async def line(self, who: str, kind: str, count: int = 1, **members: object) -> None:
        def found() -> int:
            return sum(
                line["type"] == kind and members.items() <= line.items() for line in self.lines(who)
            )

        await eventually(
            lambda: found() >= count, lambda: f"{who} {kind} {members}: {self.lines(who)}", WAIT_S
        )

    def sent_by(self, who: str) -> list[dict[str, Any]]:
        """The lines in their order, without what varies; heartbeats, which come at their times, once and last."""
        sent_lines, heartbeats = [], {}
        for line in self.lines(who):
            same = line | {name: type(line[name]) for name in VARIES if name in line}
            if line["type"] in ("ping", "pong"):
                heartbeats[line["type"]] = same
            else:
                sent_lines.append(same)
        return [*sent_lines, *(heartbeats[name] for name in sorted(heartbeats))]


@asynccontextmanager
async def at_server(make: Robot) -> AsyncIterator[tuple[Played, RelayServer, MemoryDatabase]]:
    """A robot at a server of its own, on which ann may drive it."""
    database = MemoryDatabase()
    robot = database.add_robot(7, "sim1", u1="drive")
    place = Path(tempfile.mkdtemp(prefix="rt-"))
    timing = replace(FAST, timeout_s=2 * WAIT_S, idle_heartbeat_s=WAIT_S)
    async with running_relay(database, timing) as relay:
        server = RecordingServer(relay, robot.id)
        server.ports = (robot.ros_port, robot.video_port)
        await server.start()
        try:
            async with make(server, place):
                yield Played(server), relay, database
        finally:
            await server.close()
            shutil.rmtree(place)


def as_ann(database: MemoryDatabase) -> aiohttp.ClientSession:
    token = database.add_credential("token", RelayUser(1, "ann"))
    return aiohttp.ClientSession(headers={"Authorization": f"Bearer {token}"})


async def begin_to_move(driver: aiohttp.ClientWebSocketResponse, played: Played) -> None:
    """Drive until the guard says that the robot moves; on a busy machine a command may come too late."""
    await driver.send_json({"op": "advertise", **TYPED})
    moving = asyncio.ensure_future(played.line("agent", "guard", moving=True))
    while not moving.done():
        await driver.send_json(MOVE)
        await asyncio.wait({moving}, timeout=0.1)
    await moving


@asynccontextmanager
async def answering_pings(driver: aiohttp.ClientWebSocketResponse) -> AsyncIterator[None]:
    """Read, without which aiohttp answers no ping, and every command counts as old half a second after the upgrade."""

    async def read() -> None:
        async for _ in driver:
            pass

    reading = asyncio.ensure_future(read())
    yield
    reading.cancel()
    await asyncio.gather(reading, return_exceptions=True)


async def play(make: Robot) -> Played:
    """Have a robot return to a server, be driven, stopped and released, renamed, and disabled."""
    async with at_server(make) as (played, relay, database), as_ann(database) as http:
        robot = database.robots[7]
        # A start depends on how quickly guard and services start; a return does not.
        await played.line("agent", "check")
        await played.line("agent", "guard", state="ready")
        played.began = len(played.server.said)
        played.server.ssh.drop_connections()
        await played.line("agent", "check")
        await played.line("relay", "checked", ros="ok")
        async with http.get(f"http://{HOST}:{robot.ros_port}/") as answer:
            played.statuses.append(answer.status)
        async with http.ws_connect(relay.ros_url(robot)) as driver, answering_pings(driver):
            await begin_to_move(driver, played)
            await played.line("agent", "guard", count=2, moving=False)
        await played.line("relay", "lease", fence=1, held=False)
        for order, rests in (("stop", {"stopped": True, "moving": False}), ("release", {})):
            async with http.post(f"{relay.url}/api/v1/robots/sim1/{order}") as answer:
                played.statuses.append(answer.status)
            await played.line("agent", "guard", **rests)
        renamed = replace(robot, name="turtle")
        for changed in (renamed, replace(renamed, state="disabled")):
            database.robots = {7: changed}
            await relay.relay.fleet.poll()
        await played.line("relay", "bye")
    return played


async def test_the_server_cannot_tell_a_virtual_robot_from_an_agent() -> None:
    real, virtual = await asyncio.gather(play(real_agent), play(virtual_robot))
    assert virtual.sent_by("agent") == real.sent_by("agent") != []
    assert virtual.statuses == real.statuses == [426, 200, 200]
