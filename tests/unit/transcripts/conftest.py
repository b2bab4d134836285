"""Compares transcripts with the files beside the tests, and runs a relay that records them."""

from contextlib import asynccontextmanager
from dataclasses import replace

import aiohttp
import pytest
from fake_robot import FakeRobot
from msgspec import structs
from relay_server import ANN, FAST, SESSION_KEY, MemoryDatabase, running_relay, until
from robotether_server.relay.control import stops
from robotether_server.relay.robots import lease, port_checks, robot_dialer
from timed_websocket import timed_session
from transcripts import TranscriptFile

LONG_S = 60.0


@pytest.fixture
def recorded(snapshot):
    """What was recorded of this test; `--snapshot-update` records it anew."""
    return snapshot.use_extension(TranscriptFile)


@pytest.fixture
def patient(monkeypatch):
    """Times of a relay that calls nobody silent, slow or late because the machine is busy."""
    for module, name in (
        (stops, "CONFIRMED_WITHIN_S"),
        (stops, "RELEASED_WITHIN_S"),
        (lease, "PASSES_AFTER_S"),
        (lease, "RESERVED_FOR_S"),
        (port_checks, "CONNECT_WITHIN_S"),
        (robot_dialer, "MIN_CONNECT_TIMEOUT_S"),
        (robot_dialer, "MAX_CONNECT_TIMEOUT_S"),
    ):
        monkeypatch.setattr(module, name, LONG_S)
    return replace(FAST, timeout_s=LONG_S)


class World:
    """A relay with robot sim1, which ann and ben drive, bob observes and carl manages; and who connects."""

    def __init__(self, relay, database, http):
        self.relay = relay
        self.database = database
        self.http = http
        self._robots = []

    @property
    def sim1(self):
        return self.database.robots[7]

    async def robot(self, mode="guarded"):
        """Bring the robot online, and wait until the relay knows all of it."""
        made = FakeRobot(7, SESSION_KEY, mode)
        self._robots.append(made)
        await made.start(self.relay.relay.session_port)
        # What the robot says last of all.
        registry = self.relay.relay.registry
        await until(lambda: registry.presence(7).ros == "ok", "the robot is online", LONG_S)
        made.frames.mode = "behaves"
        return made

    async def change(self, **settings):
        row = replace(self.sim1, settings=structs.replace(self.sim1.settings, **settings))
        self.database.robots = {7: row}
        await self.relay.relay.fleet.poll()

    def connect(self, mode="drive", user=ANN, **options):
        url = self.relay.ros_url(self.sim1, mode, user)
        return self.http.ws_connect(url, max_msg_size=0, **options)

    async def ask(self, user, what, **members):
        """Change the control of sim1 over HTTP."""
        url = f"{self.relay.url}/api/v1/robots/sim1/{what}"
        headers = self.database.bearer(user)
        async with self.http.post(url, json=members, headers=headers) as answer:
            assert answer.status == 200, await answer.text()

    async def close(self):
        for robot in self._robots:
            await robot.stop()


@asynccontextmanager
async def running_world(timing):
    database = MemoryDatabase()
    database.add_robot(7, "sim1", u1="drive", u2="observe", u3="drive", u4="manage")
    connector = aiohttp.TCPConnector(force_close=True)
    async with (
        running_relay(database, timing) as relay,
        timed_session(connector=connector) as http,
    ):
        world = World(relay, database, http)
        # No command is late because the machine is busy.
        guard = structs.replace(world.sim1.settings.guard, max_age_ms=60_000)
        await world.change(guard=guard)
        try:
            yield world
        finally:
            await world.close()


@pytest.fixture
def open_world():
    return running_world


@pytest.fixture
async def world(patient):
    async with running_world(patient) as made:
        yield made
