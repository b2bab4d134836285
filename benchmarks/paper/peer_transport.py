"""A way between an operator near the server and a robot behind a link: what every one of them must be able to do.

Used by the comparison with what else a user would take (peers.py). A way starts programs inside the uplink's two
namespaces only, the server's beside the way to the stack, and ends all that it started. Which way it is must make no
difference to what is measured (peer_measure.py).
"""

from __future__ import annotations

import shutil
import socket
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import aiohttp
from demo import ROOT
from namespaces import Namespace
from openssh_server import listens, wait_until
from video_viewers import OnFrame, view_stream

from paper.peer_plan import DEFAULT_QUALITY, FITTING_QUALITY, STRAIGHT, TITLES
from paper.peer_program import Program

if TYPE_CHECKING:
    from paper.uplinks import Uplink

SIM_ROBOT = ROOT / "images" / "sim_robot"
ROS_PORT, VIDEO_PORT = 9090, 8080
CAMERA = "/camera/image_raw"
DRIVE, OBSERVE = "drive", "observe"
STARTS_WITHIN_S = 20.0
# What Debian's kernels have; a way that chooses nothing gets this one, whatever this machine was set to.
CONGESTION_CONTROL = "cubic"


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
        """For people."""
        return TITLES[self.key]

    @property
    def inside(self) -> Namespace:
        """Where the robot is."""
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._made.close()

    @abstractmethod
    def prepare(self, made: ExitStack) -> None:
        """Start the server's side and the robot's ROS, and leave to `made` how they end."""

    @abstractmethod
    def connect(self) -> None:
        """Start the robot's client program; returns before it is connected."""

    def disconnect(self) -> None:
        """End the robot's client program."""
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

    def connector(self) -> aiohttp.TCPConnector:
        """Make the operator's connections where the operator is; inside the running loop."""
        return connector_in(self.server)

    def robot_pids(self) -> list[int]:
        """The processes that carry on the robot's side."""
        return [pid for one in self._client for pid in one.pids()]

    @abstractmethod
    def server_pids(self) -> list[int]:
        """The processes that carry on the server's side."""


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
        given = {"PYTHONPATH": str(SIM_ROBOT), "SIM_NAME": "peer", "SIM_LOG_LEVEL": "error"}
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
        """Start a program of this way."""
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

    def server_pids(self) -> list[int]:
        return []


def connector_in(namespace: Namespace) -> aiohttp.TCPConnector:
    """Make sockets inside a namespace; one stays where it was made, wherever it is used."""

    def make(address: aiohttp.AddrInfoType) -> socket.socket:
        family, kind, protocol, *_ = address
        with namespace.entered():
            return socket.socket(family, kind, protocol)

    return aiohttp.TCPConnector(force_close=True, socket_factory=make)
