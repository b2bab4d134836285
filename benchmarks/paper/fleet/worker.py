"""A process of light robots, started by fleet.py in an uplink's namespace as `python -m paper.fleet.worker`.

Each robot is a rosbridge of its own, the real agent and its own OpenSSH clients. The guard's own code runs in the same
process, between the same two interfaces as in its own: the agent's lines and rosbridge. What a process of its own is
for is missing: a robot whose agent hangs is not stopped here. Lines of JSON go both ways: the first one in names the
robots and their agents' settings, those that follow are orders; out come `done` for each order, `got` for each message
that a robot's subscriber receives, and `failed`. It ends with its input, and must never leave an SSH client behind.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import random
import resource
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any, NoReturn

from fake_pipe import FakePipe
from robotether_agent import settings as agent_settings
from robotether_agent.daemon import Agent
from robotether_agent.fields import JsonObject, line_of, parse_object
from robotether_agent.guard.agent_messages import GuardReporter
from robotether_agent.guard.child_process import EXIT_S, TICK, TICK_S, GuardProcess
from robotether_agent.guard.process import MAX_LINE_BYTES, Guard
from robotether_agent.guard.supervisor import GuardSupervisor
from robotether_agent.problems import GuardDownError
from robotether_agent.rosbridge_socket import new_http
from robotether_agent.settings import Settings
from robotether_agent.systemd import Notifier
from robotether_agent.tasks import first_of
from sim_robot.graph import Node, TopicMessage

from paper.bus_robot import BusRobot
from paper.programs import write_line
from paper.world import environment

TOPIC, TYPE = "/startup", "std_msgs/String"
LOCALHOST = "127.0.0.1"
# Sockets, pipes and listeners of one robot, with room.
FILES_A_ROBOT = 80
LINE_BYTES = 1024 * 1024
# It is no setting of a file of this machine that the robots go by.
NO_FILE = Path("/dev/null")
LOG_FORMAT = "%(asctime)s %(levelname)s %(message)s"
log = logging.getLogger(__name__)


class _Pipe(FakePipe):
    """The guard's standard output, as a queue of lines."""

    def __init__(self) -> None:
        super().__init__()
        self.queue: asyncio.Queue[JsonObject] = asyncio.Queue()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.queue.put_nowait(parse_object(bytes(data), "the line"))


class GuardHere:
    """A running guard, as GuardProcess is one."""

    pid = os.getpid()

    def __init__(self, state_dir: Path, run_dir: Path) -> None:
        self._messages = asyncio.StreamReader(limit=MAX_LINE_BYTES)
        self._pipe = _Pipe()
        self._life = asyncio.ensure_future(self._run(state_dir, run_dir))

    def send(self, message: Mapping[str, object]) -> None:
        self._messages.feed_data(line_of(message))

    async def serve(self, on_line: Callable[[JsonObject], None]) -> NoReturn:
        """Tick, and hand on each line of the guard; raise GuardDownError when it has ended."""
        await first_of(self._until_end(), self._listen(on_line), self._tick())
        raise GuardDownError("the guard ended")

    async def end(self) -> None:
        """Let the guard stop the robot and end."""
        self.send({"type": "exit"})
        await asyncio.wait({self._life}, timeout=EXIT_S)
        await self.kill()

    async def kill(self) -> None:
        self._life.cancel()
        await asyncio.gather(self._life, return_exceptions=True)

    async def _run(self, state_dir: Path, run_dir: Path) -> None:
        async with new_http() as http:
            await Guard(http, state_dir, run_dir, GuardReporter(self._pipe)).run(self._messages)

    async def _until_end(self) -> None:
        await asyncio.wait({self._life})
        with suppress(asyncio.CancelledError):
            self._life.result()

    async def _listen(self, on_line: Callable[[JsonObject], None]) -> None:
        while True:
            on_line(await self._pipe.queue.get())

    async def _tick(self) -> None:
        while True:
            self.send(TICK)
            await asyncio.sleep(TICK_S)


class SupervisorHere(GuardSupervisor):
    """Keeps a guard in this process, and no fork server: Python need not start for it."""

    def __init__(self, settings: Settings, **others: object) -> None:
        super().__init__(settings.rosbridge_url, (), **others)  # type: ignore[arg-type] # the supervisor's own
        self._directories = settings.state_dir, settings.run_dir

    async def _start_guard(self) -> GuardProcess:
        return GuardHere(*self._directories)  # type: ignore[return-value] # has all that it uses

    async def _keep_fork_server(self) -> NoReturn:
        await asyncio.Event().wait()
        raise AssertionError


class LightAgent(Agent):
    """The agent, all of it; its guard is no process of its own."""

    def _supervisor(self) -> GuardSupervisor:
        return SupervisorHere(self._settings, on_change=self._show_guard)


class Robot(ABC):
    """What a process of robots plays; it is connected from `start` on."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._running: asyncio.Task[None] | None = None

    @abstractmethod
    async def open(self) -> None:
        """Have all that needs no server."""

    def start(self) -> None:
        self._running = asyncio.create_task(self._run())

    async def close(self) -> None:
        if self._running is not None:
            self._running.cancel()
            await asyncio.gather(self._running, return_exceptions=True)

    @abstractmethod
    async def play(self) -> None:
        """Be the robot."""

    async def _run(self) -> None:
        try:
            await self.play()
        except Exception as error:
            # The border of a robot: the others go on.
            log.exception("the robot %s ended", self.name)
            write_line({"robot": self.name, "failed": repr(error)})


class RosRobot(Robot):
    """One with a rosbridge of its own, which tells what it was sent on a topic."""

    def __init__(
        self, name: str, topic: str, message_type: str, on_message: Callable[[TopicMessage], None]
    ) -> None:
        super().__init__(name)
        self._ros = BusRobot(LOCALHOST, 0)
        self._ros.graph.bus.subscribe(topic, message_type, Node("/listener"), on_message)

    async def open(self) -> None:
        await self._ros.__aenter__()

    async def close(self) -> None:
        await super().close()
        await self._ros.__aexit__()

    @property
    def rosbridge_url(self) -> str:
        return f"ws://{LOCALHOST}:{self._ros.rosbridge.port}"


class LightRobot(RosRobot):
    """One robot with its agent."""

    def __init__(self, name: str, given: Mapping[str, str]) -> None:
        super().__init__(name, TOPIC, TYPE, self._on_message)
        self._given = given

    async def play(self) -> None:
        await LightAgent(self._settings, Notifier(None), random.SystemRandom()).run()

    def _on_message(self, message: TopicMessage) -> None:
        at_ns = time.monotonic_ns()
        write_line({"robot": self.name, "got": message.values["data"], "at_ns": at_ns})

    @property
    def _settings(self) -> Settings:
        given = {
            **self._given,
            "rosbridge_url": self.rosbridge_url,
            # No camera: what is asked for is one message.
            "video_source": "rosbridge",
            "shell_address": "none",
        }
        return agent_settings.load(NO_FILE, environment(given))


class Robots:
    """All robots of a process by their names, and the orders that they obey."""

    def __init__(self, robots: Mapping[str, Robot]) -> None:
        self.robots = robots

    async def serve(self, lines: asyncio.StreamReader) -> None:
        """Play them by the orders that come in; they end with the input."""
        allow_files(len(self.robots) * FILES_A_ROBOT)
        every = list(self.robots.values())
        await asyncio.gather(*(robot.open() for robot in every))
        try:
            write_line({"done": "open"})
            while line := await lines.readline():
                order = json.loads(line)
                await self.obey(**order)
                write_line({"done": order["do"]})
        finally:
            await asyncio.gather(*(robot.close() for robot in every))

    async def obey(self, do: str) -> None:
        if do == "start":
            for robot in self.robots.values():
                robot.start()
        else:
            raise ValueError(f"there is no order {do}")


async def standard_input() -> asyncio.StreamReader:
    lines = asyncio.StreamReader(limit=LINE_BYTES)
    protocol = asyncio.StreamReaderProtocol(lines)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
    return lines


async def work(make: Callable[[str, Mapping[str, str]], Robot]) -> None:
    """Play the robots that the first line of the input names, by the orders that follow."""
    lines = await standard_input()
    wanted: dict[str, Any] = json.loads(await lines.readline())
    robots = {name: make(name, settings) for name, settings in wanted.items()}
    await Robots(robots).serve(lines)


def allow_files(count: int) -> None:
    """Let this process have so many files open, if it may not yet."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < count:
        resource.setrlimit(resource.RLIMIT_NOFILE, (count, max(count, hard)))


def watch_children() -> None:
    """Let this loop wait for its children without a thread for each, as the usual watcher of an older Python has it."""
    if sys.version_info < (3, 12):
        watcher = asyncio.PidfdChildWatcher()
        watcher.attach_loop(asyncio.get_running_loop())
        asyncio.set_child_watcher(watcher)


async def work_light(run_dirs: Path) -> None:
    watch_children()
    numbers = count(1)

    def make(name: str, settings: Mapping[str, str]) -> LightRobot:
        return LightRobot(name, {**settings, "run_dir": str(run_dirs / str(next(numbers)))})

    await work(make)


def main() -> None:
    """Work in folders that end with this process; their paths must be short, as they hold sockets."""
    logging.basicConfig(level=logging.WARNING, format=LOG_FORMAT)
    with tempfile.TemporaryDirectory(prefix="rt-", dir="/tmp") as folder:
        asyncio.run(work_light(Path(folder)))


if __name__ == "__main__":
    main()
