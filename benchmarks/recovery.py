"""How soon a robot is drivable again after its network was cut or changed, or its agent stood still or was killed.

Real agents, each in a network of its own (roaming.py), with a real sshd and the real relay. The time runs from the
moment in which the robot has a network again until a new drive connection through the relay has passed a message and
its answer. All cuts are made side by side, each on a robot of its own. Used by `bench`;
needs root.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import aiohttp
from namespaces import Namespace
from openssh_server import OpenSshServer
from paper.programs import Program, our_environment
from paper.world import environment
from relay_server import SESSION_KEY, MemoryDatabase, RelayServer, running_relay
from report import Row, Section, quantiles
from roaming import RoamingNetwork, roaming_networks
from robotether_agent.enrolment.enroller import Enrolment, EnrolmentStore
from robotether_agent.enrolment.join import SshAccess, parse_host_keys
from robotether_agent.enrolment.keys import ensure_key
from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.wiring import Timing

REPEAT = 50
AIM_S = 2.0
# Nobody waits longer: it counts as a failure.
GIVE_UP_S = 30.0
STARTS_WITHIN_S = 30.0
# An attempt that went into a dead tunnel is ended by the relay when the robot comes back; this is for the rest.
ATTEMPT_S = 1.0
PAUSE_S = 0.02
MAC = "00:1b:44:11:3a:b7"
CALL = {"op": "call_service", "id": "recovery", "service": "/rosapi/topics"}


@dataclass
class Site:
    """What all robots share."""

    relay: RelayServer
    records: MemoryDatabase
    sshd: OpenSshServer
    http: aiohttp.ClientSession


@dataclass(frozen=True)
class Network:
    """What an agent needs of its robot's network, as RoamingNetwork has it too."""

    # The server's address there.
    server: str
    robot: Namespace


class Subject:
    """One robot: its network, its agent, and its user."""

    def __init__(
        self, site: Site, network: Network | RoamingNetwork, robot: RelayRobot, folder: Path
    ) -> None:
        self.network = network
        self._site = site
        self.robot = robot
        self._folder = folder
        self._agent: Program | None = None

    async def enrol(self) -> None:
        """Put into its place what a join would have brought."""
        state = self._folder / "state"
        state.mkdir(mode=0o700)
        sshd, robot = self._site.sshd, self.robot
        key = await ensure_key(state)
        sshd.authorize_too(key.public, (robot.ros_port, robot.video_port), robot.id)
        access = SshAccess(sshd.user, self.network.server, (sshd.port,))
        enrolment = Enrolment(self.network.server, robot.name, MAC, access)
        EnrolmentStore(state).keep(enrolment, parse_host_keys({"host_keys": sshd.host_keys}))

    def start_agent(self) -> None:
        settings = {
            "server": self.network.server,
            "mac": MAC,
            "state_dir": self._folder / "state",
            "run_dir": self._folder / "run",
            "shell_address": "none",
            "log_level": "debug",
        }
        words = (sys.executable, "-m", "robotether_agent", "run")
        environ = our_environment() | environment(settings)
        self._agent = Program(self.network.robot, words, self._folder / "agent.log", environ)

    def signal_agent(self, number: signal.Signals) -> None:
        """Send a signal to the agent, and to nothing that it started."""
        assert self._agent is not None
        os.kill(self._agent.pid, number)

    def kill_agent(self) -> None:
        """Kill it and all that it started, as the loss of power does."""
        if self._agent is not None:
            self._agent.kill()

    def log_tail(self) -> str:
        return self._agent.tail() if self._agent else ""

    async def drivable_after(self, since: float, give_up_s: float) -> float:
        """Return the seconds from `since` until a new drive connection passes a message; infinite if never."""
        while time.monotonic() < since + give_up_s:
            with suppress(aiohttp.ClientError, asyncio.TimeoutError, TypeError):
                await asyncio.wait_for(self._drive(), ATTEMPT_S)
                return time.monotonic() - since
            await asyncio.sleep(PAUSE_S)
        return math.inf

    async def _drive(self) -> None:
        url = self._site.relay.ros_url(self.robot)
        async with self._site.http.ws_connect(
            url, timeout=aiohttp.ClientWSTimeout(ws_close=0.05)
        ) as client:
            await client.send_json(CALL)
            while json.loads(await client.receive_str())["op"] != "service_response":
                pass


@dataclass
class Cut:
    """One way to lose a robot, and how long it took each time until it was drivable."""

    name: str
    # Does it, and returns the moment in which the robot had a network again.
    make: Callable[[Subject], Awaitable[float]]
    took_s: list[float] = field(default_factory=list)

    @property
    def row(self) -> Row:
        """A failure is a time at which it was not drivable; it is in no percentile."""
        good = [value for value in self.took_s if math.isfinite(value)]
        failures = len(self.took_s) - len(good)
        return {"after": self.name, **quantiles(good, 0.5, 0.99, 1), "failures": failures}


def dropped_for(seconds: float) -> Callable[[Subject], Awaitable[float]]:

    async def make(subject: Subject) -> float:
        await asyncio.to_thread(subject.network.cut)
        await asyncio.sleep(seconds)
        await asyncio.to_thread(subject.network.mend)
        return time.monotonic()

    return make


async def readdressed(subject: Subject) -> float:
    await asyncio.to_thread(subject.network.readdress)
    return time.monotonic()


async def roamed(subject: Subject) -> float:
    """Move the robot to another network; the one before is gone."""
    await asyncio.to_thread(subject.network.roam)
    return time.monotonic()


async def frozen(subject: Subject) -> float:
    """Stop the agent alone, for longer than a session lives."""
    subject.signal_agent(signal.SIGSTOP)
    await asyncio.sleep(10)
    subject.signal_agent(signal.SIGCONT)
    return time.monotonic()


async def rebooted(subject: Subject) -> float:
    await asyncio.to_thread(subject.kill_agent)
    at_s = time.monotonic()
    subject.start_agent()
    return at_s


def cuts() -> list[Cut]:
    return [
        *(Cut(f"packets dropped for {seconds} s", dropped_for(seconds)) for seconds in (3, 10, 20)),
        Cut("another address", readdressed),
        Cut("default route to another network", roamed),
        Cut("agent frozen for 10 s", frozen),
        Cut("agent killed and started, as by a reboot", rebooted),
    ]


async def measure_all(networks: Sequence[RoamingNetwork], repeat: int) -> list[Cut]:
    """Make each cut `repeat` times; this thread must be in the cloud's namespace."""
    made = cuts()
    async with AsyncExitStack() as stack:
        subjects = await _start_all(stack, networks)
        await asyncio.gather(
            *(_measure(*pair, repeat) for pair in zip(made, subjects, strict=True))
        )
    return made


async def _start_all(stack: AsyncExitStack, networks: Sequence[RoamingNetwork]) -> list[Subject]:
    site, robots = await start_site(stack, len(networks), "0.0.0.0")
    subjects = []
    for network, robot in zip(networks, robots, strict=True):
        log = Path(stack.enter_context(TemporaryDirectory(prefix="rt-ros-"))) / "log"
        words = (sys.executable, "-m", "paper.bus_robot", "127.0.0.1", "9090")
        stack.callback(Program(network.robot, words, log, our_environment()).end)
        subjects.append(await start_subject(stack, site, network, robot))
    return subjects


async def start_site(
    stack: AsyncExitStack, how_many: int, address: str
) -> tuple[Site, list[RelayRobot]]:
    """Relay and sshd, which end with the stack, and what they know of so many robots."""
    records = MemoryDatabase()
    robots = [
        records.add_robot(number, f"sim{number}", u1="drive") for number in range(1, how_many + 1)
    ]
    relay = await stack.enter_async_context(running_relay(records, Timing()))
    sshd = OpenSshServer(relay.relay.session_port, address=address, session_key=SESSION_KEY)
    stack.callback(sshd.close)
    await asyncio.to_thread(sshd.start)
    http = await stack.enter_async_context(aiohttp.ClientSession())
    return Site(relay, records, sshd, http), robots


async def start_subject(
    stack: AsyncExitStack, site: Site, network: Network | RoamingNetwork, robot: RelayRobot
) -> Subject:
    """Its agent, which ends with the stack."""
    # The agent's own directory, which holds sockets, must have a short name.
    folder = Path(mkdtemp(prefix="rt-"))
    stack.callback(shutil.rmtree, folder, ignore_errors=True)
    subject = Subject(site, network, robot, folder)
    stack.callback(subject.kill_agent)
    await subject.enrol()
    subject.start_agent()
    return subject


async def _measure(cut: Cut, subject: Subject, repeat: int) -> None:
    rng = random.Random(cut.name)
    for _ in range(repeat):
        if math.isinf(await subject.drivable_after(time.monotonic(), STARTS_WITHIN_S)):
            raise RuntimeError(
                f"{cut.name}: the robot is not drivable at all:\n{subject.log_tail()}"
            )
        # Cuts come at any moment of a heartbeat, and mostly to connections that stood for a while.
        await asyncio.sleep(rng.uniform(1, 2))
        since = await cut.make(subject)
        cut.took_s.append(await subject.drivable_after(since, GIVE_UP_S))
        sys.stderr.write(f"{cut.name}: {cut.took_s[-1]:.2f} s\n")
        if cut.took_s[-1] > AIM_S:
            sys.stderr.write(subject.log_tail() + "\n")


def measure(repeat: int = REPEAT) -> Section:
    with roaming_networks(len(cuts())) as (cloud, networks), cloud.entered():
        made = asyncio.run(measure_all(networks, repeat))
    return Section(
        title="How soon a robot is drivable again",
        text="Seconds from when the robot has a network again until a new drive connection through the relay has "
        f"passed a message and its answer, {repeat} times each. All rows run at once, on one machine with network "
        "namespaces. A reboot is a kill and a start of the agent and of all that it started, without the machine's "
        f"boot.\n\nAim: {AIM_S:g} s at p99 and no failure.",
        rows=[cut.row for cut in made],
    )
