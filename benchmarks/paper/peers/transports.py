"""The ways from an operator near the server to a robot behind a link that are compared; VPNs are in vpn.py.

A way starts programs inside the uplink's two namespaces only, the server's beside the way to the stack, and ends all
that it started, by their own ids. Which way it is must make no difference to what is measured (measures.py).
Robotether does what the others do not: TLS to the operator, tickets and permissions, a guard on the robot, frames by
credit. The bare `ssh -R` is kept by autossh, with the settings of its manual and the usual guides: no monitoring port,
and keep-alives of OpenSSH's own at both ends, which decide how soon a dead tunnel is noticed.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import aiohttp
from bare_tunnel import new_key, ssh_command
from namespaces import Namespace
from openssh_server import OpenSshServer, listens, wait_until
from video_viewers import OnFrame, view_frames, view_stream

from paper.client import new_http
from paper.costs import trees_cpu_s, use_of
from paper.networks import SLOW_4G, Uplink, made_in
from paper.programs import Program, our_environment
from paper.robots import WholeRobot
from paper.world import World

LINK = SLOW_4G
OURS, STRAIGHT, SSH = "robotether", "straight", "ssh"
# In the page's order.
TITLES: Mapping[str, str] = {
    STRAIGHT: "straight rosbridge, no tunnel",
    SSH: "bare ssh -R, autossh",
    "wireguard": "WireGuard in user space",
    "openvpn": "OpenVPN, UDP",
    "nebula": "nebula",
    OURS: "Robotether",
}
# web_video_server's own quality, which makes more than the link takes, and one that fits.
DEFAULT_QUALITY, FITTING_QUALITY = "quality 95", "quality 80"
FRAMES = "frames protocol"
ROS_PORT, VIDEO_PORT = 9090, 8080
CAMERA = "/camera/image_raw"
DRIVE, OBSERVE = "drive", "observe"
STARTS_WITHIN_S = 20.0
# What Debian's kernels have; a way that chooses nothing gets this one, whatever this machine was set to.
CONGESTION_CONTROL = "cubic"
# Many guides say 30 s three times, which would take three times as long to notice.
ALIVE_S, ALIVE_TIMES = 10, 3
# What carries a robot's and an operator's data; web and database only let them in.
CARRIERS = ("nginx", "relay", "sshd")


class Transport(ABC):
    """One way; inside `with` the server's side stands and the robot's ROS runs, `connect` starts the robot's side."""

    # In TITLES.
    key: str
    # Debian's, beside OpenSSH.
    packages: Sequence[str] = ()
    # What of the camera can be looked at.
    videos: Sequence[str] = (DEFAULT_QUALITY, FITTING_QUALITY)

    def __init__(self, uplink: Uplink) -> None:
        self.uplink = uplink
        self.folder: Path
        self._client: list[Program] = []
        self._made = ExitStack()

    @property
    def title(self) -> str:
        return TITLES[self.key]

    @property
    def inside(self) -> Namespace:
        return self.uplink.inside

    @property
    def server(self) -> Namespace:
        """The link's other end, where the peers' server side and their operator are."""
        return self.uplink.server_end

    def __enter__(self) -> Self:
        with ExitStack() as made:
            # A short name, as it may hold sockets.
            self.folder = Path(tempfile.mkdtemp(prefix="rt-peer-"))
            made.callback(shutil.rmtree, self.folder, ignore_errors=True)
            for end in (self.inside, self.server):
                end.sysctl("net.ipv4.tcp_congestion_control", CONGESTION_CONTROL)
            self.prepare(made)
            made.callback(self.disconnect)
            self._made = made.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._made.close()

    @abstractmethod
    def prepare(self, made: ExitStack) -> None:
        """Start the server's side and the robot's ROS, and leave to `made` how they end."""

    @abstractmethod
    def connect(self) -> None:
        """Start the robot's client program; returns before it is connected."""

    def disconnect(self) -> None:
        clients, self._client = self._client, []
        for one in clients:
            one.end()

    def check(self) -> None:
        """Raise with its last words if the robot's client program has ended."""
        for one in self._client:
            one.check()

    def words(self) -> str:
        """What the robot's client program said last, for failures."""
        return "\n".join(one.tail() for one in self._client)

    def readdress(self) -> None:
        """Give the robot another address; returns when it has it."""
        self.uplink.readdress()

    @abstractmethod
    def ros_url(self, mode: str = DRIVE) -> str:
        """Where the operator's next rosbridge connection goes; may ask the server, so it may block."""

    def local_ros_url(self) -> str:
        """The robot's rosbridge as the robot's own programs reach it."""
        return f"ws://127.0.0.1:{ROS_PORT}/"

    @abstractmethod
    async def view(self, http: aiohttp.ClientSession, video: str, on_frame: OnFrame) -> None:
        """Look at the camera, as one of `videos`, until it ends or the task is cancelled."""

    def http(self) -> aiohttp.ClientSession:
        """Make the operator's connections where the operator is; inside the running loop."""
        return new_http(force_close=True, **made_in(self.server))

    def robot_cpu_s(self) -> float:
        """Processor time so far of what carries on the robot's side."""
        return sum(trees_cpu_s(one.pid for one in self._client))

    @abstractmethod
    def server_cpu_s(self) -> float:
        """Processor time so far of what carries on the server's side."""


class PlainTransport(Transport):
    """A way at whose operator's end both ports of the robot are found at one address."""

    @abstractmethod
    def robot_address(self) -> str:
        """The robot's address as the operator knows it."""

    def ros_url(self, mode: str = DRIVE) -> str:
        # Who has such a way may do everything.
        return f"ws://{self.robot_address()}:{ROS_PORT}/"

    async def view(self, http: aiohttp.ClientSession, video: str, on_frame: OnFrame) -> None:
        quality = video.removeprefix("quality ")
        base = f"http://{self.robot_address()}:{VIDEO_PORT}"
        await view_stream(http, f"{base}/stream?topic={CAMERA}&quality={quality}", on_frame)

    def simulator(self, made: ExitStack) -> None:
        """Start the simulated robot, at all of its addresses, and wait until both ports answer."""
        given = {**our_environment(), "SIM_NAME": "peer", "SIM_LOG_LEVEL": "error"}
        words = (sys.executable, "-m", "sim_robot")
        robot = Program(self.inside, words, self.folder / "robot.log", given)
        made.callback(robot.end)
        with self.inside.entered():
            wait_until(
                lambda: listens(ROS_PORT) and listens(VIDEO_PORT),
                lambda: f"the simulated robot answers; its last words:\n{robot.tail()}",
                STARTS_WITHIN_S,
            )

    def start(self, namespace: Namespace, name: str, *words: str) -> Program:
        return Program(namespace, words, self.folder / f"{name}.log")


class Straight(PlainTransport):
    """No tunnel: the operator reaches the robot's own address over the link. The limit of all others."""

    key = STRAIGHT

    def prepare(self, made: ExitStack) -> None:
        self.simulator(made)

    def connect(self) -> None:
        """There is nothing to start."""

    def robot_address(self) -> str:
        # Somebody must tell the operator of a new one; here it is known at once.
        return self.inside.address

    def server_cpu_s(self) -> float:
        return 0.0


class AutoSsh(PlainTransport):
    """A bare `ssh -R`."""

    key, packages = SSH, ("autossh",)
    _sshd: OpenSshServer

    def prepare(self, made: ExitStack) -> None:
        self.simulator(made)
        alive = (f"ClientAliveInterval {ALIVE_S}", f"ClientAliveCountMax {ALIVE_TIMES}")
        # No session is opened, so that what is behind the session command is never asked.
        self._sshd = OpenSshServer(relay_port=0, address=self.server.address, more=alive)
        made.callback(self._sshd.close)
        self._key, public = new_key(self.folder)
        self._sshd.authorize(public, (ROS_PORT, VIDEO_PORT))
        name = f"[{self._sshd.address}]:{self._sshd.port}"
        (self.folder / "known_hosts").write_text(f"{name} {self._sshd.host_keys[0]}\n")
        with self.server.entered():
            self._sshd.start()

    def connect(self) -> None:
        options = (
            "BatchMode=yes",
            f"UserKnownHostsFile={self.folder}/known_hosts",
            f"ServerAliveInterval={ALIVE_S}",
            f"ServerAliveCountMax={ALIVE_TIMES}",
            "ExitOnForwardFailure=yes",
        )
        forwards = {port: f"127.0.0.1:{port}" for port in (ROS_PORT, VIDEO_PORT)}
        address = self._sshd.address
        _, *words = ssh_command(self._sshd, self._key, forwards, address, bind="*", options=options)
        # As in the guides' unit files: it goes on also when its first connection fails.
        environ = ("env", "AUTOSSH_GATETIME=0")
        self._client = [self.start(self.inside, "autossh", *environ, "autossh", "-M", "0", *words)]

    def robot_address(self) -> str:
        return self.server.address

    def server_cpu_s(self) -> float:
        return sum(trees_cpu_s(self._sshd.pids()[:1]))


class Robotether(Transport):
    """The whole of it."""

    key = OURS
    videos: Sequence[str] = (FRAMES,)
    _robot: WholeRobot

    def __init__(self, world: World, uplink: Uplink) -> None:
        super().__init__(uplink)
        self._world = world

    def prepare(self, made: ExitStack) -> None:
        [enrolled] = self._world.enrol(self._world.names("peers", 1))
        made.callback(self._world.remove, [enrolled])
        self._robot = WholeRobot(self._world, enrolled, self.uplink, "simulator")
        made.callback(self._robot.__exit__, None, None, None)
        self._robot.start_ros()
        wait_until(
            self._robot.answers,
            lambda: f"the simulated robot answers:\n{self._robot.logs()}",
            STARTS_WITHIN_S,
        )

    def connect(self) -> None:
        self._robot.start_agent()

    def disconnect(self) -> None:
        self._robot.end_agent()

    def check(self) -> None:
        if gone := self._robot.ended():
            raise RuntimeError(f"{gone}:\n{self._robot.logs()}")

    def words(self) -> str:
        return self._robot.logs()

    def ros_url(self, mode: str = DRIVE) -> str:
        ticket = self._world.ticket(self._robot.name, mode)
        return f"wss://{self._world.address}/robots/{self._robot.name}/ros?ticket={ticket}"

    def local_ros_url(self) -> str:
        return self._robot.ros_url

    async def view(self, http: aiohttp.ClientSession, video: str, on_frame: OnFrame) -> None:
        ticket = await asyncio.to_thread(self._world.ticket, self._robot.name, OBSERVE)
        base = f"https://{self._world.address}/robots/{self._robot.name}/video"
        await view_frames(http, f"{base}/frames?topic={CAMERA}&ticket={ticket}", on_frame)

    def http(self) -> aiohttp.ClientSession:
        return new_http(force_close=True)

    def robot_cpu_s(self) -> float:
        return sum(trees_cpu_s([self._robot.agent_pid]))

    def server_cpu_s(self) -> float:
        return sum(use_of(self._world.container(service)).cpu_s for service in CARRIERS)
