"""A process of light robots: `python -m paper.fleet_worker`, started by `fleet` in an uplink's namespace.

Each robot is a rosbridge of its own, the real agent with its guard (fleet_guard) and its own OpenSSH clients. Lines of
JSON go both ways: the first one in names the robots and their agents' settings, those that follow say what to do; out
come `done` for each order, `got` for each message that a robot's subscriber hears, and `failed`. The end of input
is the end. It must never leave an SSH client behind.
"""

from __future__ import annotations

import asyncio
import json
import logging
import random
import resource
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from robotether_agent import settings as agent_settings
from robotether_agent.settings import Settings
from robotether_agent.systemd import Notifier
from sim_robot.graph import Node, TopicMessage

from paper.bus_robot import BusRobot
from paper.enrolled import environment
from paper.fleet_guard import LightAgent

TOPIC, TYPE = "/startup", "std_msgs/String"
LOCALHOST = "127.0.0.1"
# Sockets, pipes and listeners of one robot, with room.
FILES_A_ROBOT = 80
LINE_BYTES = 1024 * 1024
# It is no setting of a file of this machine that the robots go by.
NO_FILE = Path("/dev/null")

log = logging.getLogger(__name__)


class LightRobot:
    """One robot; its agent runs between `start` and `end`."""

    def __init__(self, name: str, given: Mapping[str, str], report: _Reporter) -> None:
        self.name = name
        self._given = given
        self._report = report
        self._ros = BusRobot(LOCALHOST, 0)
        self._ros.graph.bus.subscribe(TOPIC, TYPE, Node("/listener"), self._on_message)
        self._agent: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Start its rosbridge."""
        await self._ros.__aenter__()

    async def close(self) -> None:
        """End all of it."""
        await self.end()
        await self._ros.__aexit__()

    def start(self) -> None:
        """Start the agent."""
        self._agent = asyncio.create_task(self._run())

    async def end(self) -> None:
        """End the agent as its service does."""
        if self._agent is not None:
            self._agent.cancel()
            await asyncio.gather(self._agent, return_exceptions=True)
            self._agent = None

    async def _run(self) -> None:
        try:
            await LightAgent(self._settings, Notifier(None), random.SystemRandom()).run()
        except Exception as error:
            # The border of a robot: the others go on.
            log.exception("the agent of %s ended", self.name)
            self._report(failed=repr(error), robot=self.name)

    def _on_message(self, message: TopicMessage) -> None:
        at_ns = time.monotonic_ns()
        self._report(got=message.values["data"], robot=self.name, at_ns=at_ns)

    @property
    def _settings(self) -> Settings:
        port = self._ros.rosbridge.port
        given = {
            **self._given,
            "rosbridge_url": f"ws://{LOCALHOST}:{port}",
            # No camera: what is asked for is one message.
            "video_source": "rosbridge",
            "shell_address": "none",
        }
        return agent_settings.load(NO_FILE, environment(given))


class _Reporter:
    """Writes lines to whoever started this process."""

    def __init__(self, out: TextIO) -> None:
        self._out = out

    def __call__(self, **fields: object) -> None:
        self._out.write(json.dumps(fields) + "\n")
        self._out.flush()


class Worker:
    """All robots of this process."""

    def __init__(self, robots: Sequence[LightRobot], report: _Reporter) -> None:
        self._robots = robots
        self._report = report

    async def obey(self, order: str) -> None:
        """Do one order, and tell when it is done."""
        if order == "start":
            for robot in self._robots:
                robot.start()
        elif order == "end":
            await asyncio.gather(*(robot.end() for robot in self._robots))
        else:
            raise ValueError(f"there is no order {order}")
        self._report(done=order)


async def _standard_input() -> asyncio.StreamReader:
    lines = asyncio.StreamReader(limit=LINE_BYTES)
    protocol = asyncio.StreamReaderProtocol(lines)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
    return lines


async def work(run_dirs: Path) -> None:
    """Serve orders until there are no more."""
    if sys.version_info < (3, 12):
        # The usual watcher of this Python has a thread for each child.
        watcher = asyncio.PidfdChildWatcher()
        watcher.attach_loop(asyncio.get_running_loop())
        asyncio.set_child_watcher(watcher)
    lines, report = await _standard_input(), _Reporter(sys.stdout)
    wanted: dict[str, Any] = json.loads(await lines.readline())
    robots = [
        LightRobot(name, {**settings, "run_dir": str(run_dirs / str(number))}, report)
        for number, (name, settings) in enumerate(wanted.items())
    ]
    allow_files(len(robots) * FILES_A_ROBOT)
    await asyncio.gather(*(robot.open() for robot in robots))
    worker = Worker(robots, report)
    try:
        report(done="open")
        while line := await lines.readline():
            await worker.obey(json.loads(line))
    finally:
        await asyncio.gather(*(robot.close() for robot in robots))


def allow_files(count: int) -> None:
    """Let this process have so many files open, if it may not yet."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < count:
        resource.setrlimit(resource.RLIMIT_NOFILE, (count, max(count, hard)))


def main() -> None:
    """Work in folders that end with this process; their paths must be short, as they hold sockets."""
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(message)s")
    with tempfile.TemporaryDirectory(prefix="rt-", dir="/tmp") as folder:
        asyncio.run(work(Path(folder)))


if __name__ == "__main__":
    main()
