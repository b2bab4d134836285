"""Real agents in networks of their own, with a real sshd and the real relay in this process; no demo is needed.

The robots' ROS side is the simulator. Needs root for the networks.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import shutil
import signal
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import aiohttp
from link import Link, Shape, why_not_here
from namespaces import Namespace
from openssh_server import OpenSshServer
from paper.costs import trees_cpu_s
from paper.programs import Program
from paper.world import environment
from relay_server import SESSION_KEY, MemoryDatabase, RelayServer, running_relay
from robotether_agent.enrolment.enroller import Enrolment, EnrolmentStore
from robotether_agent.enrolment.join import SshAccess, parse_host_keys
from robotether_agent.enrolment.keys import ensure_key
from robotether_server.db.fleet import RelayRobot
from robotether_server.relay.options import Timing
from robotether_server.tickets import Mode

# The worst of the paper's networks.
UP_MBIT_S, DOWN_MBIT_S = 4.97, 7.13
UP = Shape(rate_bit_s=UP_MBIT_S * 1e6, delay_s=0.019, queue_bytes=256 * 1024)
DOWN = Shape(rate_bit_s=DOWN_MBIT_S * 1e6, delay_s=0.019, queue_bytes=256 * 1024)
ROS_PORT, VIDEO_PORT = 9090, 8080
FPS = 15
# Of the cameras, unless a benchmark says more: pixels, and frames a second.
SMALL_CAMERA = {"width": 640, "height": 480, "fps": FPS}
WIDE_CAMERA = {"width": 1280, "height": 720, "fps": 25}
STARTS_WITHIN_S = 30.0
# An attempt that went into a dead tunnel is ended by the relay when the robot comes back; this is for the rest.
ATTEMPT_S = 1.0
PAUSE_S = 0.02
MAC = "00:1b:44:11:3a:b7"
CALL = {"op": "call_service", "id": "drivable", "service": "/rosapi/topics"}
# Gives the address of what a robot has, with a ticket of this mode.
Address = Callable[[str, Mode], str]


@dataclass
class Site:
    relay: RelayServer
    records: MemoryDatabase
    sshd: OpenSshServer
    http: aiohttp.ClientSession

    def address_of(self, robot: RelayRobot) -> Address:
        def address(path: str, mode: Mode) -> str:
            return f"{self.relay.url}/robots/{robot.name}/{path}ticket={self.relay.ticket(robot, mode)}"

        return address


@dataclass
class Subject:
    """One robot: its network, in which the server has this address, its agent, and its user."""

    site: Site
    server: str
    inside: Namespace
    robot: RelayRobot
    folder: Path
    _agent: Program | None = None

    async def enrol(self) -> None:
        state = self.folder / "state"
        state.mkdir(mode=0o700)
        sshd, robot = self.site.sshd, self.robot
        key = await ensure_key(state)
        sshd.authorize_too(key.public, (robot.ros_port, robot.video_port), robot.id)
        access = SshAccess(sshd.user, self.server, (sshd.port,))
        enrolment = Enrolment(self.server, robot.name, MAC, access)
        EnrolmentStore(state).keep(enrolment, parse_host_keys({"host_keys": sshd.host_keys}))

    def start_agent(self) -> None:
        settings = {
            "server": self.server,
            "mac": MAC,
            "state_dir": self.folder / "state",
            "run_dir": self.folder / "run",
            "shell_address": "none",
            "log_level": "debug",
        }
        words, log = ("robotether_agent", "run"), self.folder / "agent.log"
        self._agent = Program(self.inside, words, log, environment(settings))

    def signal_agent(self, number: signal.Signals) -> None:
        assert self._agent is not None
        os.kill(self._agent.pid, number)

    def cpu_s(self) -> float:
        """Processor time of the agent and all that it started."""
        assert self._agent is not None
        [cpu_s] = trees_cpu_s([self._agent.pid])
        return cpu_s

    def kill_agent(self) -> None:
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

    async def until_drivable(self) -> None:
        if math.isinf(await self.drivable_after(time.monotonic(), STARTS_WITHIN_S)):
            raise RuntimeError(f"the robot is not drivable at all:\n{self.log_tail()}")

    async def _drive(self) -> None:
        url, closing = self.site.relay.ros_url(self.robot), aiohttp.ClientWSTimeout(ws_close=0.05)
        async with self.site.http.ws_connect(url, timeout=closing) as client:
            await client.send_json(CALL)
            while json.loads(await client.receive_str())["op"] != "service_response":
                pass


async def start_site(
    stack: AsyncExitStack, how_many: int, address: str
) -> tuple[Site, list[RelayRobot]]:
    """Relay and sshd, which end with the stack, and what they know of so many robots."""
    records = MemoryDatabase()
    robots = [
        records.add_robot(number, f"sim{number}", u1="manage") for number in range(1, how_many + 1)
    ]
    relay = await stack.enter_async_context(running_relay(records, Timing()))
    sshd = OpenSshServer(relay.relay.session_port, address=address, session_key=SESSION_KEY)
    stack.callback(sshd.close)
    await asyncio.to_thread(sshd.start)
    http = await stack.enter_async_context(aiohttp.ClientSession())
    return Site(relay, records, sshd, http), robots


async def start_subject(
    stack: AsyncExitStack, site: Site, server: str, inside: Namespace, robot: RelayRobot
) -> Subject:
    """Its agent, which ends with the stack."""
    # The agent's own directory, which holds sockets, must have a short name.
    folder = Path(mkdtemp(prefix="rt-"))
    stack.callback(shutil.rmtree, folder, ignore_errors=True)
    subject = Subject(site, server, inside, robot, folder)
    stack.callback(subject.kill_agent)
    await subject.enrol()
    subject.start_agent()
    return subject


@contextmanager
def emulated(up: Shape = UP, down: Shape = DOWN) -> Iterator[Link]:
    """A link, on whose robot's side TCP is cubic; this thread is in the server's namespace meanwhile."""
    with emulated_links(1, up, down) as [link]:
        yield link


@contextmanager
def emulated_links(count: int, up: Shape, down: Shape) -> Iterator[list[Link]]:
    """Links to one server, each with a robot's network of its own."""
    if why := why_not_here():
        raise RuntimeError(f"cannot measure over a link: {why}")
    with ExitStack() as stack:
        links: list[Link] = []
        for _ in range(count):
            beside = links[-1] if links else None
            links.append(stack.enter_context(Link(up=up, down=down, beside=beside)))
            links[-1].robot.sysctl("net.ipv4.tcp_congestion_control", "cubic")
        stack.enter_context(links[0].server.entered())
        yield links


@asynccontextmanager
async def linked_robot(
    link: Link, camera: Mapping[str, int] = SMALL_CAMERA
) -> AsyncIterator[tuple[Site, Subject]]:
    async with linked_robots([link], camera) as (site, [subject]):
        yield site, subject


@asynccontextmanager
async def linked_robots(
    links: Sequence[Link], camera: Mapping[str, int] = SMALL_CAMERA
) -> AsyncIterator[tuple[Site, list[Subject]]]:
    """Real relay and sshd at the server's end of the links, a real agent and a simulator at the robot's of each.

    The simulators' cameras have this size and rate.
    """
    server = links[0].server.address
    async with AsyncExitStack() as stack:
        site, robots = await start_site(stack, len(links), server)
        subjects = []
        for link, robot in zip(links, robots, strict=True):
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="rt-sim-")))
            given = {
                "SIM_NAME": robot.name,
                "SIM_BIND_ADDRESS": "127.0.0.1",
                "SIM_CAMERA_FPS": str(camera["fps"]),
                "SIM_CAMERA_SIZE": f"{camera['width']}x{camera['height']}",
                "SIM_LOG_LEVEL": "error",
            }
            simulator = Program(link.robot, ("sim_robot",), folder / "log", given)
            stack.callback(simulator.end)
            subjects.append(await start_subject(stack, site, server, link.robot, robot))
        yield site, subjects
