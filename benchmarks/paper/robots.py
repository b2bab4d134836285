"""A whole robot, the ROS side and the real agent with its guard, behind an uplink of its own."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from openssh_server import descendants

from paper.networks import Uplink
from paper.programs import Program, our_environment
from paper.world import Enrolled, World, environment

# Robots have processors of their own. Where hundreds of their processes would push the server's off the two cores that
# both have to share here, what is measured would be how that is decided; so the server comes first while they start.
ASIDE = ("nice", "-n", "19")
PROC = Path("/proc")
ROSBRIDGE_PORT = 9090
# Each look costs the server a list of all its robots.
POLL_EVERY_S = 0.25


def no_longer_aside(pids: Sequence[int]) -> None:
    """Give these processes, all that they have started, and what these start from now on, the normal priority."""
    for pid in [*pids, *(below for root in pids for below in descendants(root))]:
        # One may have ended meanwhile.
        with suppress(FileNotFoundError, ProcessLookupError):
            # To Linux a priority is a thread's, and one with a lock of the interpreter makes the others wait.
            for thread in (PROC / str(pid) / "task").iterdir():
                os.setpriority(os.PRIO_PROCESS, int(thread.name), 0)


class WholeRobot:
    """One robot that runs inside `with`."""

    def __init__(self, world: World, enrolled: Enrolled, uplink: Uplink) -> None:
        self.name = enrolled.name
        self.uplink = uplink
        self.enrolled = enrolled
        self.world = world
        self.address = loopback(enrolled.number)
        self._agent: Program
        self._ros: Program
        self._made = ExitStack()

    @property
    def ros_url(self) -> str:
        return f"ws://{self.address}:{ROSBRIDGE_PORT}"

    def __enter__(self) -> WholeRobot:
        with ExitStack() as made:
            run_dir = made.enter_context(
                TemporaryDirectory(prefix="rt-", ignore_cleanup_errors=True)
            )
            bus_robot = ("paper.bus_robot", self.address, str(ROSBRIDGE_PORT))
            self._ros = self._start("ros", bus_robot, {})
            made.callback(self._ros.end)
            self._agent = self._start("agent", ("robotether_agent", "run"), self._settings(run_dir))
            made.callback(self._agent.end)
            self._made = made.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._made.close()

    def wait_online(self, seconds: float = 60) -> None:
        """Wait until the server says that it is online and its rosbridge answers; else show its logs."""
        deadline = time.monotonic() + seconds
        while not (self._is_online() and self._answers()):
            why = self._ended() or f"not online within {seconds:g} s"
            if self._ended() or time.monotonic() > deadline:
                raise RuntimeError(f"the robot {self.name} is not ready: {why}\n{self._logs()}")
            time.sleep(POLL_EVERY_S)

    def _is_online(self) -> bool:
        robots = self.world.api("GET", "/robots")["robots"]
        return any(robot["name"] == self.name and robot["online"] for robot in robots)

    def _answers(self) -> bool:
        with self.uplink.inside.entered():
            probe = socket.socket()
        with probe:
            return probe.connect_ex((self.address, ROSBRIDGE_PORT)) == 0

    def _ended(self) -> str:
        """Say which of its processes has ended by itself, or nothing."""
        return ", ".join(filter(None, (item.ended() for item in (self._agent, self._ros))))

    def _logs(self) -> str:
        return "\n".join(f"--- {self.name}\n{item.tail()}" for item in (self._ros, self._agent))

    def _settings(self, run_dir: str) -> Mapping[str, str]:
        settings = {
            **self.enrolled.settings,
            "run_dir": run_dir,
            "rosbridge_url": self.ros_url,
            # A bus has no frames; so nobody looks for them every 2 s.
            "video_source": "rosbridge",
            "shell_address": "none",
        }
        return environment(settings)

    def _start(self, name: str, words: Sequence[str], given: Mapping[str, str]) -> Program:
        command = (sys.executable, "-m", *words)
        log = self.enrolled.folder / f"{name}.log"
        return Program(self.uplink.inside, command, log, {**our_environment(), **given})


def loopback(number: int) -> str:
    """An address of loopback for robot `number`, which counts to 65,535."""
    return f"127.{1 + number // 256 % 254}.{number % 256}.1"
