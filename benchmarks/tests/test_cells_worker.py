"""What a robot of cells writes down: what came to its guard, what moved it, and what the guard confirmed."""

from __future__ import annotations

import asyncio
import shutil
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiohttp
import pytest
from fake_cloud import agent_environ, eventually
from paper.cells.checker import Database, check
from paper.cells.history import Event, History, read
from paper.cells.worker import CellRobot, PlayedRobot, RealRobot
from paper.client import TOPIC, TYPE, command
from recording_server import RecordingServer
from relay_server import MemoryDatabase, RelayServer, running_relay
from robotether_agent import settings as agent_settings
from robotether_agent.enrolment.enroller import Enroller
from robotether_server.db.fleet import RelayRobot, RelayUser

WAIT_S = 60.0
PREFIX = "ROBOTETHER_"


class Scene:
    """One robot at a relay, a driver of it, and the history so far."""

    def __init__(
        self,
        relay: RelayServer,
        known: RelayRobot,
        http: aiohttp.ClientSession,
        robot: CellRobot,
        folder: Path,
    ) -> None:
        self.relay, self.known, self.http, self.robot = relay, known, http, robot
        self._folder = folder

    def history(self) -> list[Event]:
        return read(self._folder)

    def kinds(self) -> list[str]:
        """In their order, each of several in a row once."""
        found: list[str] = []
        for one in self.history():
            if one.kind != "late" and (not found or found[-1] != one.kind):
                found.append(one.kind)
        return found

    async def until(self, kind: str, count: int = 1) -> None:
        await eventually(
            lambda: sum(one.kind == kind for one in self.history()) >= count,
            lambda: f"{count} times {kind}: {self.kinds()}",
            WAIT_S,
        )

    async def order(self, what: str) -> None:
        async with self.http.post(f"{self.relay.url}/api/v1/robots/sim1/{what}") as answer:
            assert answer.status == 200, await answer.text()

    @asynccontextmanager
    async def driving(self, connection: int) -> AsyncIterator[None]:
        """Drive at 20 Hz."""
        async with self.http.ws_connect(self.relay.ros_url(self.known)) as socket:
            await socket.send_json({"op": "advertise", "topic": TOPIC, "type": TYPE})
            tasks = [
                asyncio.ensure_future(work) for work in (_send(socket, connection), _read(socket))
            ]
            try:
                yield
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)


async def _send(socket: aiohttp.ClientWebSocketResponse, connection: int) -> None:
    number = 0
    while not socket.closed:
        await socket.send_json(command(number, connection))
        number += 1
        await asyncio.sleep(0.05)


async def _read(socket: aiohttp.ClientWebSocketResponse) -> None:
    async for _ in socket:
        pass


@pytest.fixture(params=[RealRobot, PlayedRobot])
async def scene(request: pytest.FixtureRequest) -> AsyncIterator[Scene]:
    database = MemoryDatabase()
    known = database.add_robot(7, "sim1", u1="drive")
    token = database.add_credential("token", RelayUser(1, "ann"))
    headers = {"Authorization": f"Bearer {token}"}
    place = Path(tempfile.mkdtemp(prefix="rt-"))
    folder = place / "history"
    folder.mkdir()
    async with running_relay(database) as relay, aiohttp.ClientSession(headers=headers) as http:
        server = RecordingServer(relay, known.id)
        server.ports = (known.ros_port, known.video_port)
        await server.start()
        environ = agent_environ(server, place)
        await Enroller(agent_settings.load(None, environ)).join()
        given = {name.removeprefix(PREFIX).lower(): one for name, one in environ.items()}
        (place / "run").mkdir(exist_ok=True)
        history = History.open(folder, "robots")
        robot = request.param("sim1", given, history)
        robot.cells = {f"127.0.0.1:{server.ssh.port}": "main"}
        await robot.open()
        robot.start()
        try:
            yield Scene(relay, known, http, robot, folder)
        finally:
            await robot.close()
            history.close()
            await server.close()
            shutil.rmtree(place)


async def test_a_drive_with_a_stop_and_a_release_breaks_no_rule(scene: Scene) -> None:
    await scene.until("session")
    async with scene.driving(101):
        await scene.until("moved", 5)
        await scene.order("stop")
        await scene.until("stopped")
    await scene.order("release")
    await scene.until("released")
    async with scene.driving(102):
        await scene.until("moved", 12)
    await eventually(lambda: scene.kinds()[-1] == "zeroed", lambda: f"{scene.kinds()}", WAIT_S)
    history = scene.history()
    moved = {one.connection for one in history if one.kind == "moved"}
    fences = {one.connection: one.fence for one in history if one.kind == "arrived"}
    assert moved == {"101", "102"}
    assert fences == {"101": 1, "102": 2}
    [session] = [one for one in history if one.kind == "session"]
    assert session.cell == "main"
    assert session.epoch > 0
    drives = {("sim1", 1), ("sim1", 2)}
    asked = [Event(at_s=one.at_s - 0.01, kind="release_asked", robot="sim1")
             for one in history if one.kind == "released"]  # fmt: skip
    whole = sorted([*history, *asked], key=lambda one: one.at_s)
    assert check(whole, Database(drives=drives, fences={"sim1": 2})) == []
