"""A running relay with one robot, for tests of the whole of it; and a watch on what tests leave."""

import asyncio
import time
import warnings
from contextlib import AsyncExitStack
from dataclasses import replace
from urllib.parse import urlencode

import aiohttp
import pytest
import pytest_asyncio
import uvloop
from fake_robot import FakeRobot, RobotSession
from frames_viewer import FramesViewer
from local_network import free_ports
from msgspec import structs
from relay_server import ANN, FAST, SESSION_KEY, MemoryDatabase, running_relay, until
from robotether_server.db.migrate import set_port_range
from robotether_server.relay.robots import port_checks, robot_dialer
from robotether_server.settings import robot as robot_settings
from timed_websocket import timed_session
from yarl import URL


class FakeOperator:
    """A driver's WebSocket that sends clock syncs and stamped commands, as the drive page does."""

    def __init__(self, connecting):
        self.messages = []
        self._connecting = connecting
        self._ahead_ms = []

    async def __aenter__(self):
        self._socket = await self._connecting
        self._reader = asyncio.create_task(self._read())
        return self

    async def __aexit__(self, *_exc):
        self._reader.cancel()
        await asyncio.gather(self._reader, return_exceptions=True)
        await self._socket.close()

    @staticmethod
    def clock_ms():
        """What the page's clock shows; it began when the page did."""
        return time.monotonic() * 1000 - 5e6

    async def send(self, **message):
        await self._socket.send_json(message)

    async def clock_sync(self):
        await self.send(op="robotether.clock_sync", t_ms=self.clock_ms())
        await self.until("robotether.clock_sync")

    async def drive(self, speed, *, age_ms=0.0, **stamp):
        """Send a command of an input event that was so long ago; `stamp` are more members beside its time."""
        stamp["t_ms"] = self.clock_ms() - age_ms + max(self._ahead_ms)
        msg = {"linear": {"x": speed}}
        await self.send(op="publish", topic="/cmd_vel", msg=msg, robotether=stamp)

    async def until(self, what):
        """Wait for the next message of this operation."""
        await until(lambda: any(each["op"] == what for each in self.messages), f"{what} came")
        message = next(each for each in self.messages if each["op"] == what)
        self.messages.remove(message)
        return message

    async def _read(self):
        async for data in self._socket:
            message = data.json()
            if message["op"] == "robotether.clock_sync":
                self._ahead_ms.append(message["relay_ms"] - self.clock_ms())
            self.messages.append(message)


class StrictLoop(uvloop.Loop):
    """Fails when a test has left something open; uvloop's own end never comes where its warning is an error."""

    def close(self):
        with warnings.catch_warnings(record=True) as left:
            warnings.simplefilter("always")
            super().close()
        if left:
            raise ResourceWarning("; ".join(str(each.message) for each in left))


def pytest_asyncio_loop_factories():
    """Test with the loop that the relay runs with."""
    return {"uvloop": StrictLoop}


@pytest_asyncio.fixture(autouse=True)
async def _no_task_left():
    before = asyncio.all_tasks()
    yield
    left = set()
    for _ in range(50):
        left = asyncio.all_tasks() - before
        left.discard(asyncio.current_task())
        if not left:
            return
        await asyncio.sleep(0.01)
    pytest.fail(f"tasks left behind: {left}")


@pytest.fixture
def admin_database(admin_database):
    """The emptied database; its robots' ports are free here, as something listens on them."""
    ports = free_ports(8)
    with admin_database.transaction() as tx:
        set_port_range(tx, ports[0], ports[-1])
    return admin_database


@pytest.fixture
def memory_database():
    """Records with robot sim1, which user 1 drives and user 2 observes."""
    memory_database = MemoryDatabase()
    memory_database.add_robot(7, "sim1", u1="drive", u2="observe")
    return memory_database


@pytest.fixture
def sim1(memory_database):
    return memory_database.robots[7]


@pytest.fixture
def timing():
    return FAST


@pytest.fixture(autouse=True)
def robots_may_answer_late(monkeypatch):
    """A relay waits for a robot as long as a busy machine may take."""
    monkeypatch.setattr(robot_dialer, "MIN_CONNECT_TIMEOUT_S", FAST.timeout_s)
    monkeypatch.setattr(port_checks, "CONNECT_WITHIN_S", FAST.timeout_s)


@pytest_asyncio.fixture
async def relay(memory_database, timing):
    async with running_relay(memory_database, timing) as server:
        yield server


@pytest_asyncio.fixture
async def opened(http):
    """What a test opens, and its end closes."""
    async with AsyncExitStack() as stack:
        yield stack


@pytest.fixture
def start_robot(sim1, opened):
    async def start(relay, mode="guard_off", robot_id=sim1.id):
        robot = FakeRobot(robot_id, SESSION_KEY, mode)
        opened.push_async_callback(robot.stop)
        await robot.start(relay.relay.session_port)
        return robot

    return start


@pytest_asyncio.fixture
async def robot(relay, sim1, start_robot):
    robot = await start_robot(relay)
    await until(lambda: relay.relay.registry.presence(sim1.id).ros == "ok", "sim1 is well")
    return robot


@pytest.fixture
def login(memory_database):
    text = memory_database.add_credential("login", ANN)
    return {"Cookie": f"session=abc; __Host-robotether_login={text}"}


@pytest.fixture
def ros(relay, sim1, http):
    """Connect to sim1's rosbridge, to drive it as ann unless a test says otherwise."""

    def connect(mode="drive", user=ANN, credential=None, **options):
        return http.ws_connect(relay.ros_url(sim1, mode, user, credential), **options)

    return connect


@pytest.fixture
def program(ros):
    """Connect a program that sends clock syncs."""
    return lambda mode="drive", user=ANN: FakeOperator(ros(mode, user))


@pytest.fixture
def video(relay, sim1, http, login):
    """Ask for a path of sim1's video, as ann who is logged in unless a test says otherwise."""

    def ask(path, headers=login, method="GET"):
        url = URL(f"{relay.url}/robots/sim1/video/{path}", encoded=True)
        return http.request(method, url, headers=headers)

    return ask


@pytest_asyncio.fixture
async def camera(robot):
    robot.frames.mode = "behaves"
    return robot.frames


@pytest.fixture
def watch(relay, sim1, http, opened):
    async def open_viewer(user=None, topic="/a", **wanted):
        query = urlencode({"topic": topic, "ticket": relay.ticket(sim1, "observe", user)})
        url = f"{relay.url}/robots/{sim1.name}/video/frames?{query}"
        connecting = http.ws_connect(url, autoping=wanted.pop("autoping", True))
        viewer = FramesViewer(await opened.enter_async_context(connecting))
        await viewer.ask(**wanted)
        return viewer

    return open_viewer


@pytest_asyncio.fixture
async def viewer(camera, watch):
    viewer = await watch()
    await camera.wait_for("credit")
    return viewer


@pytest_asyncio.fixture
async def guarded(relay, sim1, start_robot):
    robot = await start_robot(relay, "guarded")
    await until(lambda: relay.relay.registry.presence(sim1.id).guard == "ready", "it is ready")
    return robot


@pytest.fixture
def connect(relay, sim1, opened):
    async def open_session(kind="session", **changes):
        fields = {"robot_id": sim1.id, "session_key": SESSION_KEY} | changes
        session = RobotSession(fields.pop("robot_id"), kind=kind, **fields)
        opened.push_async_callback(session.close)
        await session.connect(relay.relay.session_port)
        return session

    return open_session


@pytest_asyncio.fixture
async def http():
    connector = aiohttp.TCPConnector(force_close=True)
    async with timed_session(connector=connector) as session:
        yield session


@pytest.fixture
def no_command_is_late(memory_database, sim1):
    """A client that does not read answers no ping, and its commands grow old while the machine is busy."""
    guard = structs.replace(sim1.settings.guard, max_age_ms=60_000)
    patient = replace(sim1, settings=structs.replace(sim1.settings, guard=guard))
    memory_database.robots = {**memory_database.robots, sim1.id: patient}
    return patient


@pytest.fixture
def wide(memory_database, no_command_is_late):
    """Robot sim1, to which drivers may publish all and as much as may be, however late."""
    policy = robot_settings.parse(
        {"policy": {"drive": {"publish": ["*"]}, "limits": {"message_kb": 10_240}}}
    ).policy
    settings = structs.replace(no_command_is_late.settings, policy=policy)
    wide = replace(no_command_is_late, settings=settings)
    memory_database.robots = {wide.id: wide}
    return wide
