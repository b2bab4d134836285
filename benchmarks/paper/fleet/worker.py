"""A process of robots, started by fleet.py in an uplink's namespace as `python -m paper.fleet.worker`.

Some are light: a rosbridge of its own, the real agent and its own OpenSSH clients. The guard's own code runs in the
same process, between the same two interfaces as in its own: the agent's lines and rosbridge. What a process of its own
is for is missing: a robot whose agent hangs is not stopped here. The others are virtual (paper.virtual). Lines of JSON
go both ways: the first one in names the robots of both kinds and their agents' settings, those that follow are orders;
out come `done` for each order, and `failed`. It ends with its input, and must never leave an SSH client behind.
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
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine, Mapping
from contextlib import AbstractAsyncContextManager, suppress
from pathlib import Path
from typing import Any, NoReturn

from fake_pipe import FakePipe
from robotether_agent import settings as agent_settings
from robotether_agent.daemon import Agent
from robotether_agent.fields import JsonObject, line_of, parse_object
from robotether_agent.guard.agent_messages import GuardReporter
from robotether_agent.guard.child_process import EXIT_S, TICK, TICK_S, GuardProcess
from robotether_agent.guard.drive_messages import DriveMessage
from robotether_agent.guard.process import MAX_LINE_BYTES, Guard
from robotether_agent.guard.supervisor import GuardSupervisor
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.problems import GuardDownError
from robotether_agent.rosbridge_socket import new_http
from robotether_agent.settings import Settings
from robotether_agent.systemd import Notifier
from robotether_agent.tasks import first_of

from paper.bus_robot import BusRobot
from paper.programs import write_line
from paper.virtual.robot import Account, VirtualRobot
from paper.virtual.services import Services
from paper.world import environment

LOCALHOST = "127.0.0.1"
# Sockets, pipes and listeners of one robot, with room.
FILES_A_ROBOT = 80
LINE_BYTES = 1024 * 1024
# It is no setting of a file of this machine that the robots go by.
NO_FILE = Path("/dev/null")
LOG_FORMAT = "%(asctime)s %(levelname)s %(message)s"
log = logging.getLogger(__name__)


class _Pipe(FakePipe):
    def __init__(self) -> None:
        super().__init__()
        self.queue: asyncio.Queue[JsonObject] = asyncio.Queue()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.queue.put_nowait(parse_object(bytes(data), "the line"))


class Watch:
    """Hears what happens at a robot, `on_...`; of one that nobody watches nothing is kept."""

    def __getattr__(self, _name: str) -> Callable[..., None]:
        return lambda *_what, **_how: None


class GuardHere:
    """A running guard, as GuardProcess is one."""

    pid = os.getpid()

    def __init__(self, state_dir: Path, run_dir: Path, watch: Watch) -> None:
        self._watch = watch
        self._messages = asyncio.StreamReader(limit=MAX_LINE_BYTES)
        self._pipe = _Pipe()
        self._life = asyncio.ensure_future(self._run(state_dir, run_dir))

    def send(self, message: Mapping[str, object]) -> None:
        self._watch.on_order(message)
        self._messages.feed_data(line_of(message))

    def offer(self, message: Mapping[str, object]) -> None:
        self.send(message)

    async def serve(self, on_line: Callable[[JsonObject], None]) -> NoReturn:
        await first_of(self._until_end(), self._listen(on_line), self._tick())
        raise GuardDownError("the guard ended")

    async def end(self) -> None:
        self.send({"type": "exit"})
        await asyncio.wait({self._life}, timeout=EXIT_S)
        await self.kill()

    async def kill(self) -> None:
        self._life.cancel()
        await asyncio.gather(self._life, return_exceptions=True)

    async def _run(self, state_dir: Path, run_dir: Path) -> None:
        async with new_http() as http:
            guard = Guard(http, state_dir, run_dir, GuardReporter(self._pipe))
            controller = guard._controller
            handle = controller.handle

            async def watched(source: Any, message: DriveMessage) -> None:
                self._watch.on_arrived(message)
                await handle(source, message)

            controller.handle = watched  # type: ignore[method-assign] # nothing else knows what comes
            await guard.run(self._messages)

    async def _until_end(self) -> None:
        await asyncio.wait({self._life})
        with suppress(asyncio.CancelledError):
            self._life.result()

    async def _listen(self, on_line: Callable[[JsonObject], None]) -> None:
        while True:
            line = await self._pipe.queue.get()
            if line["type"] == "guard":
                self._watch.on_report(line)
            on_line(line)

    async def _tick(self) -> None:
        while True:
            self.send(TICK)
            await asyncio.sleep(TICK_S)


class SupervisorHere(GuardSupervisor):
    """Keeps a guard in this process, and no fork server: Python need not start for it."""

    def __init__(self, settings: Settings, watch: Watch, **others: object) -> None:
        super().__init__(settings.rosbridge_url, (), **others)  # type: ignore[arg-type] # the supervisor's own
        self._directories = settings.state_dir, settings.run_dir
        self._watch = watch
        self._here: GuardHere | None = None

    async def kill(self) -> None:
        if self._here is not None:
            self._watch.on_guard(killed=True)
            await self._here.kill()

    async def _start_guard(self) -> GuardProcess:
        self._watch.on_guard(killed=False)
        self._here = GuardHere(*self._directories, self._watch)
        return self._here  # type: ignore[return-value] # has all that it uses

    async def _keep_fork_server(self) -> NoReturn:
        await asyncio.Event().wait()
        raise AssertionError


class LightAgent(Agent):
    def __init__(self, settings: Settings, watch: Watch) -> None:
        self._watch = watch
        super().__init__(settings, Notifier(None), random.SystemRandom())

    def _supervisor(self) -> GuardSupervisor:
        self.supervisor = SupervisorHere(self._settings, self._watch, on_change=self._show_guard)
        return self.supervisor

    def _session_is_up(self, uptime: Any, target: SshAddress, *others: Any) -> None:
        super()._session_is_up(uptime, target, *others)
        self._watch.on_session(target, self._epochs._last)

    def _no_session(self, problem: Any) -> None:
        self._watch.on_session_lost()
        super()._no_session(problem)


class Robot(ABC):
    def __init__(
        self, name: str, given: Mapping[str, str], ros: AbstractAsyncContextManager[object]
    ) -> None:
        self.name = name
        self._given = given
        # All that it has without a server.
        self._ros = ros
        self._running: asyncio.Task[None] | None = None

    async def open(self) -> None:
        await self._ros.__aenter__()

    def start(self) -> None:
        self._running = asyncio.create_task(self._run())

    async def close(self) -> None:
        if self._running is not None:
            self._running.cancel()
            await asyncio.gather(self._running, return_exceptions=True)
        await self._ros.__aexit__(None, None, None)

    @abstractmethod
    async def play(self) -> None:
        pass

    async def _run(self) -> None:
        try:
            await self.play()
        except Exception as error:
            # The border of a robot: the others go on.
            log.exception("the robot %s ended", self.name)
            write_line({"robot": self.name, "failed": repr(error)})


class RosRobot(Robot):
    def __init__(self, name: str, given: Mapping[str, str]) -> None:
        self.bus = BusRobot(LOCALHOST, 0)
        super().__init__(name, given, self.bus)

    def settings(self, **more: str) -> Settings:
        url = f"ws://{LOCALHOST}:{self.bus.rosbridge.port}"
        given = {**self._given, "rosbridge_url": url, "shell_address": "none", **more}
        return agent_settings.load(NO_FILE, environment(given))


class LightRobot(RosRobot):
    async def play(self) -> None:
        # No camera: what is asked for is one message.
        await LightAgent(self.settings(video_source="rosbridge"), Watch()).run()


class FleetRobot(Robot):
    def __init__(self, name: str, given: Mapping[str, str]) -> None:
        self._services = Services()
        super().__init__(name, given, self._services)

    async def play(self) -> None:
        account = Account.read(self._given)
        await VirtualRobot(account, self._services, random.SystemRandom()).run()


class Robots:
    """All robots of a process by their names, and the orders that they obey."""

    def __init__(self, robots: Mapping[str, Robot]) -> None:
        self.robots = robots

    async def serve(self, lines: asyncio.StreamReader) -> None:
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


def allow_files(count: int) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < count:
        resource.setrlimit(resource.RLIMIT_NOFILE, (count, max(count, hard)))


def watch_children() -> None:
    """Let this loop wait for its children without a thread for each, as the usual watcher of an older Python has it."""
    if sys.version_info < (3, 12):
        watcher = asyncio.PidfdChildWatcher()
        watcher.attach_loop(asyncio.get_running_loop())
        asyncio.set_child_watcher(watcher)


async def work(wanted: Mapping[str, Any], run_dirs: Path) -> None:
    watch_children()
    robots: dict[str, Robot] = {}
    for number, (name, given) in enumerate(wanted["agents"].items()):
        robots[name] = LightRobot(name, {**given, "run_dir": str(run_dirs / str(number))})
    for name, given in wanted["virtual"].items():
        robots[name] = FleetRobot(name, given)
    await Robots(robots).serve(await standard_input())


def main(work: Callable[[Mapping[str, Any], Path], Coroutine[Any, Any, None]]) -> None:
    """Work in folders that end with this process; their paths must be short, as they hold sockets."""
    logging.basicConfig(level=logging.WARNING, format=LOG_FORMAT)
    # It tells each login, and makes a text of each packet for it.
    logging.getLogger("asyncssh").setLevel(logging.ERROR)
    wanted = json.loads(sys.stdin.readline())
    with tempfile.TemporaryDirectory(prefix="rt-", dir="/tmp") as folder:
        asyncio.run(work(wanted, Path(folder)))


if __name__ == "__main__":
    main(work)
