"""Fixtures of the agent's tests: short directories, a fake cloud, the robot's own services, no leftovers."""

import asyncio
import inspect
import os
import shutil
import socket
import sys
import tempfile
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from random import Random

import pytest
from aiohttp import WSMsgType, web
from fake_cloud import FakeCloud, agent_environ, eventually
from openssh_server import command_line, descendants, wait_until
from robotether_agent.daemon import Agent
from robotether_agent.rosbridge import RosGraph
from robotether_agent.settings import load
from robotether_agent.status import Status, read_status
from robotether_agent.systemd import Notifier
from tcp_service import WebService


class Hasty(Random):
    def uniform(self, a, b):
        return 0.05 + 0 * (a + b)


# How a process of Python's begins another one, as audit events.
STARTS = frozenset({"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.system"})
# Once a test begins a process: those that were below this one before. To look at all of a machine takes time.
processes_before = []


def note_start(event, _):
    if event in STARTS and not processes_before:
        processes_before.append(set(descendants(os.getpid())))


sys.addaudithook(note_start)


@pytest.fixture(autouse=True)
def no_processes_left():
    """Fails a test that leaves a process behind."""
    processes_before.clear()
    yield

    def left():
        return [pid for pid in descendants(os.getpid()) if pid not in processes_before[0]]

    if processes_before:
        wait_until(lambda: not left(), lambda: f"left behind: {list(map(command_line, left()))}", 5)


@pytest.fixture(autouse=True)
def no_tasks_left(request):
    """Fails a test that leaves a task of the event loop behind; one without a loop gets none for it."""
    if inspect.iscoroutinefunction(request.function):
        request.getfixturevalue("tasks_that_end")


@pytest.fixture
async def tasks_that_end():
    before = asyncio.all_tasks()
    yield

    def left():
        return asyncio.all_tasks() - before - {asyncio.current_task()}

    # A server of the test's may still learn that its client is gone.
    await eventually(lambda: not left(), lambda: f"left behind: {left()}", 5)


@pytest.fixture
async def spawn():
    """Starts tasks, and ends them with the test."""
    tasks = []

    def start(work):
        tasks.append(asyncio.ensure_future(work))
        return tasks[-1]

    yield start
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


@pytest.fixture
async def make_graph():
    """Makes connections to rosapi; a fixture that uses them in tasks names `spawn` after this one."""
    async with AsyncExitStack() as graphs:

        def make(url):
            graph = RosGraph(url)
            graphs.push_async_callback(graph.close)
            return graph

        yield make


@pytest.fixture
def place():
    """A short directory: a Unix socket's path is at most 107 bytes long."""
    made = Path(tempfile.mkdtemp(prefix="rt-"))
    yield made
    shutil.rmtree(made)


@pytest.fixture
async def make_cloud():
    made = []

    async def make(mode="serves"):
        cloud = FakeCloud(mode)
        made.append(cloud)
        await cloud.start()
        return cloud

    yield make
    for cloud in made:
        await cloud.close()


@pytest.fixture
async def cloud(make_cloud):
    return await make_cloud()


@pytest.fixture
def pair():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        here = socket.create_connection(listening.getsockname())
        there, _ = listening.accept()
    with here, there:
        yield here, there


@pytest.fixture
def connection(pair):
    """A connection whose other end is open, too."""
    return pair[0]


class RobotServices(WebService):
    """What runs on a robot: a WebSocket that echoes, and an HTTP server with one page."""

    def __init__(self):
        super().__init__()
        self.handshakes = 0
        self.video_status = 200
        self.refuse_sockets = False

    @property
    def ws_url(self):
        return self.url.replace("http", "ws")

    def _routes(self):
        return {"/": self._answer}

    async def _answer(self, request):
        if "Upgrade" not in request.headers or self.refuse_sockets:
            return web.Response(text="the list of topics", status=self.video_status)
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        self.handshakes += 1
        async for message in socket:
            if message.type is WSMsgType.TEXT:
                await socket.send_str(message.data)
        return socket


@pytest.fixture
async def services():
    async with RobotServices() as running:
        yield running


class RunningAgent:
    def __init__(self, settings):
        self.settings = settings
        self.task = asyncio.ensure_future(Agent(settings, Notifier(None), Hasty(1)).run())

    def status(self):
        return read_status(self.settings.run_dir) or Status()

    async def until(self, condition, what):
        def reached():
            return condition(self.status())

        await eventually(lambda: self.task.done() or reached(), lambda: f"{what}: {self.status()}")
        if not reached():
            self.task.result()
        return self.status()

    async def until_connected(self):
        return await self.until(
            lambda status: status.state == "connected" and status.video_tunnel == "open",
            "both tunnels are open",
        )

    async def stop(self):
        self.task.cancel()
        with suppress(asyncio.CancelledError):
            await self.task


@pytest.fixture
async def start_agent(place, services):
    """Starts agents in `place` against a cloud, without a guard, whose start takes a while; stops them at the end."""
    started = []

    def start(cloud, **more):
        urls = {"rosbridge_url": services.ws_url, "video_url": services.url}
        environ = agent_environ(cloud, place, **{**urls, "guard": "off", **more})
        agent = RunningAgent(load(None, environ))
        started.append(agent)
        return agent

    yield start
    for agent in started:
        if not agent.task.done():
            await agent.stop()


@pytest.fixture
async def agent(cloud, start_agent):
    started = start_agent(cloud)
    await started.until_connected()
    return started
