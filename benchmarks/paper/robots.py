"""Whole robots, the ROS side and the real agent with its guard behind one uplink, and their operators behind others.

    with running([WholeRobot(world, one, uplink, "simulator") for one in world.enrol(names)]) as robots:
        wait_all_online(robots)
    async with new_http(**made_in(uplink.inside)) as http:
        socket = await Client(http, world.address, world.token).connect("x-spiral-7-1")

Starting one returns at once, so that many start side by side; `running` ends them side by side, too.
"""

from __future__ import annotations

import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Literal

from openssh_server import descendants

from paper.networks import Uplink
from paper.programs import Program, our_environment
from paper.world import Enrolled, World, environment

Ros = Literal["bus", "simulator"]
# Robots have processors of their own. Where hundreds of their processes would push the server's off the two cores that
# both have to share here, what is measured would be how that is decided; so the server comes first while they start.
ASIDE = ("nice", "-n", "19")
PROC = Path("/proc")
ROSBRIDGE_PORT, VIDEO_PORT = 9090, 8080
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

    def __init__(
        self, world: World, enrolled: Enrolled, uplink: Uplink, ros: Ros, *, aside: bool = False
    ) -> None:
        self._before = ASIDE if aside else ()
        self.name = enrolled.name
        self.uplink = uplink
        self.enrolled = enrolled
        self.world = world
        self._ros_kind = ros
        # Each its own, as several robots may be behind one uplink.
        self.address = loopback(enrolled.number)
        self._agent: Program | None = None
        self._ros: Program | None = None
        self._run_dir: Path | None = None

    @property
    def ros_url(self) -> str:
        return f"ws://{self.address}:{ROSBRIDGE_PORT}"

    @property
    def video_url(self) -> str:
        """The simulator's own video server, from inside the uplink."""
        return f"http://{self.address}:{VIDEO_PORT}"

    @property
    def agent_pid(self) -> int:
        assert self._agent is not None
        return self._agent.pid

    @property
    def ros_pid(self) -> int:
        assert self._ros is not None
        return self._ros.pid

    def __enter__(self) -> WholeRobot:
        try:
            self.start_ros()
            self.start_agent()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def start_ros(self) -> None:
        if self._ros_kind == "bus":
            words, given = ["paper.bus_robot", self.address, str(ROSBRIDGE_PORT)], {}
        else:
            words, given = ["sim_robot"], self._simulator_environment()
        self._ros = self._start("ros", words, given)

    def start_agent(self) -> None:
        """Start the agent, as the boot service does; also again after it has been ended."""
        self._run_dir = self._run_dir or Path(tempfile.mkdtemp(prefix="rt-"))
        settings = {
            **self.enrolled.settings,
            "run_dir": self._run_dir,
            "rosbridge_url": self.ros_url,
            "video_url": self.video_url,
            # A bus has no frames; so nobody looks for them every 2 s.
            "video_source": "rosbridge" if self._ros_kind == "bus" else "auto",
            "shell_address": "none",
        }
        self._agent = self._start("agent", ["robotether_agent", "run"], environment(settings))

    def end_agent(self) -> None:
        """End the agent in order, as a shutdown does; what does not follow is killed."""
        if self._agent is not None:
            self._agent.end()

    def ask_agent_to_end(self) -> None:
        """Tell the agent to end, and do not wait."""
        if self._agent is not None:
            self._agent.terminate()

    def answers(self) -> bool:
        with self.uplink.inside.entered():
            probe = socket.socket()
        with probe:
            return probe.connect_ex((self.address, ROSBRIDGE_PORT)) == 0

    def ended(self) -> str:
        """Say which of its processes has ended by itself, or nothing."""
        started = (one.ended() for one in (self._agent, self._ros) if one)
        return ", ".join(filter(None, started))

    def logs(self) -> str:
        started = [one for one in (self._ros, self._agent) if one]
        return "\n".join(f"--- {self.name}\n{one.tail()}" for one in started)

    def _simulator_environment(self) -> dict[str, str]:
        settings = {
            "name": self.name,
            "bind_address": self.address,
            "rosbridge_port": ROSBRIDGE_PORT,
            "video_port": VIDEO_PORT,
        }
        return {f"SIM_{name.upper()}": str(value) for name, value in settings.items()}

    def _start(self, name: str, words: Sequence[str], given: Mapping[str, str]) -> Program:
        command = (*self._before, sys.executable, "-m", *words)
        log = self.enrolled.folder / f"{name}.log"
        return Program(self.uplink.inside, command, log, {**our_environment(), **given})

    def _end(self) -> None:
        self.end_agent()
        if self._ros is not None:
            self._ros.end()
        if self._run_dir is not None:
            shutil.rmtree(self._run_dir, ignore_errors=True)
            self._run_dir = None


@contextmanager
def running(robots: Sequence[WholeRobot]) -> Iterator[Sequence[WholeRobot]]:
    """Run them all; at the end all are told before the first one is waited for."""
    with ExitStack() as started:
        for robot in robots:
            started.enter_context(robot)
        try:
            yield robots
        finally:
            for robot in robots:
                robot.ask_agent_to_end()


def wait_all_online(robots: Sequence[WholeRobot], seconds: float = 60) -> None:
    """Wait until the server says that all are online and each one's rosbridge answers; else show their logs."""
    if not robots:
        return
    deadline = time.monotonic() + seconds
    world, missing = robots[0].world, list(robots)
    while missing := not_ready(world, missing):
        gone = [robot for robot in missing if robot.ended()]
        if gone or time.monotonic() > deadline:
            why = gone[0].ended() if gone else f"not online within {seconds:g} s"
            shown = (gone or missing)[:3]
            raise RuntimeError(
                f"{len(missing)} of {len(robots)} robots are not ready: {why}\n"
                + "\n".join(robot.logs() for robot in shown)
            )
        time.sleep(POLL_EVERY_S)


def not_ready(world: World, robots: Sequence[WholeRobot]) -> list[WholeRobot]:
    """Those that cannot be driven yet, by one request for all."""
    seen = {robot["name"]: robot["online"] for robot in world.api("GET", "/robots")["robots"]}
    return [robot for robot in robots if not (seen.get(robot.name) and robot.answers())]


def loopback(number: int) -> str:
    """An address of loopback for robot `number`, which counts to 65,535."""
    return f"127.{1 + number // 256 % 254}.{number % 256}.1"
