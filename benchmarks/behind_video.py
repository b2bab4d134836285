"""How long control takes while video fills the robot's uplink: over one SSH connection, two, and those of the agent.

Over an emulated link like the worst of the paper's (link.py), with real OpenSSH at both ends and the robot's TCP left
at cubic, a message of 200 bytes goes to the robot and comes back, 20 times a second and without waiting for the one
before. Used by `bench`; needs root. No sample may be dropped: one that is still out at the end is waited for.
"""

from __future__ import annotations

import asyncio
import json
import re
import socket
import time
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import aiohttp
from bare_tunnel import bare_forward
from link import Link, why_not_here
from link_queue import Shape
from local_network import free_port
from openssh_server import OpenSshServer, listens, make_key, wait_until
from paper.programs import LineProgram
from report import Row, Section, quantiles
from robotether_agent.clock import robot_time
from robotether_common.codecs import CODECS, JPEG
from robotether_common.frames import HEADER, MAX_CREDITS, PATH
from video_robot import FRAMES_HZ, OFFERED_BIT_S, ROS_PORT, VIDEO_PORT

UP_MBIT_S, DOWN_MBIT_S = 4.97, 7.13
UP = Shape(rate_bit_s=UP_MBIT_S * 1e6, delay_s=0.019, queue_bytes=256 * 1024)
DOWN = Shape(rate_bit_s=DOWN_MBIT_S * 1e6, delay_s=0.019, queue_bytes=256 * 1024)
MESSAGE_BYTES = 200
RATE_HZ = 20
SECONDS = 30.0
# Until the video fills what it fills.
SETTLE_S = 5.0
LAST_S = 10.0
# What viewers of the frames protocol say that they decode.
CODECS_VIEWED = ("jpeg", "h264")
# Of a part's header, the timestamp and the length.
VALUES = re.compile(rb"(?:X-Timestamp|Content-Length): ([\d.]+)")


@dataclass
class Setup:
    """One way to connect the robot, and what was measured on it."""

    name: str
    connections: str
    with_video: bool = True
    # Of the frames protocol; None: MJPEG, passed through.
    codec: str | None = None
    codecs_seen: set[str] = field(default_factory=set)
    round_trips_ms: list[float] = field(default_factory=list)
    frame_ages_ms: list[float] = field(default_factory=list)
    frame_bytes: int = 0
    lasted_s: float = 0.0


def setups() -> list[Setup]:
    return [
        Setup("one connection, as in the paper", "one"),
        Setup("two connections", "two"),
        Setup("Robotether, MJPEG passed through", "agent"),
        *(Setup(f"Robotether, frames, {codec}", "agent", codec=codec) for codec in CODECS_VIEWED),
        Setup("Robotether, no video", "agent", with_video=False),
    ]


class Site:
    """Both ends of the link, with sshd at one and the robot's services at the other."""

    def __init__(self, link: Link, folder: Path) -> None:
        self.folder = folder
        self.ros_port, self.video_port = free_port(), free_port()
        self._link = link
        self._relay = socket.create_server(("127.0.0.1", 0))
        self._sshd = OpenSshServer(self._relay.getsockname()[1], address=link.server.address)

    def __enter__(self) -> Site:
        """Start sshd; this thread must be in the server's namespace."""
        ports = (self.ros_port, self.video_port)
        self._sshd.authorize(make_key(self.folder / "key"), ports)
        known_host = f"robotether-server {self._sshd.host_keys[0]}\n"
        (self.folder / "known_hosts").write_text(known_host)
        self._sshd.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._sshd.close()
        self._relay.close()

    @contextmanager
    def connected(self, connections: str) -> Iterator[None]:
        """Make the robot's connections of this kind, and wait until both forwards stand."""
        ros = {self.ros_port: f"127.0.0.1:{ROS_PORT}"}
        video = {self.video_port: f"127.0.0.1:{VIDEO_PORT}"}
        bare = {"one": [ros | video], "two": [ros, video], "agent": []}[connections]
        where = {"host": self._sshd.address, "inside": self._link.robot, "bind": "0.0.0.0"}
        with ExitStack() as stack:
            for robot_id, forwards in enumerate(bare, 1):
                stack.enter_context(bare_forward(self._sshd, robot_id, forwards, **where))
            if connections == "agent":
                self._connect_agent(stack)
            yield
        ports = (self.ros_port, self.video_port)
        wait_until(lambda: not any(map(listens, ports)), lambda: "sshd has let go of the ports")

    def _connect_agent(self, stack: ExitStack) -> None:
        """Have the agent's connections, and answer their session commands as the relay's first line would."""
        ssh = {"host": self._sshd.address, "port": self._sshd.port}
        ports = {"ros_port": self.ros_port, "video_port": self.video_port}
        program = video_robot(self._link, self.folder, {"folder": str(self.folder), **ssh, **ports})
        stack.enter_context(program)
        self._relay.settimeout(LAST_S)
        for _ in ("session", "media"):
            session, _ = self._relay.accept()
            stack.enter_context(session).sendall(b"{}\n")
        program.receive("that it is connected", LAST_S)


def video_robot(link: Link, folder: Path, order: Mapping[str, object]) -> LineProgram:
    """What video_robot.py is told to be, in the robot's namespace."""
    log = folder / f"{'tunnels' if order else 'services'}.log"
    program = LineProgram("video_robot", log, link.robot.command())
    program.send(order)
    return program


async def measure_setup(site: Site, setup: Setup, seconds: float) -> None:
    watching = asyncio.create_task(watch(site.video_port, setup)) if setup.with_video else None
    try:
        async with aiohttp.ClientSession() as http:
            url = f"ws://127.0.0.1:{site.ros_port}/"
            async with http.ws_connect(url, compress=0, timeout=aiohttp.ClientWSTimeout()) as ros:
                await asyncio.sleep(SETTLE_S)
                setup.frame_ages_ms, setup.frame_bytes = [], 0
                setup.codecs_seen.clear()
                started = time.perf_counter()
                await round_trips(ros, setup, int(seconds * RATE_HZ))
                setup.lasted_s = time.perf_counter() - started
                await stop(watching)
                if setup.with_video and not setup.frame_ages_ms:
                    raise RuntimeError(f"cannot measure {setup.name}: no frame came")
    finally:
        await stop(watching)


async def stop(watching: asyncio.Task[None] | None) -> None:
    """Look at no more frames, so that those are counted that came in the time that is counted."""
    if watching is not None:
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)


async def round_trips(
    ros: aiohttp.ClientWebSocketResponse, setup: Setup, count: int, last_s: float = LAST_S
) -> None:
    """Send `count` messages, each at its time, and take every answer, the last one within `last_s`."""
    sent: dict[int, float] = {}

    async def answers() -> None:
        for _ in range(count):
            number = json.loads(await ros.receive_str())["number"]
            setup.round_trips_ms.append((time.perf_counter() - sent[number]) * 1000)

    receiving = asyncio.ensure_future(answers())
    started = time.perf_counter()
    for number in range(count):
        await asyncio.sleep(max(0.0, started + number / RATE_HZ - time.perf_counter()))
        text = json.dumps({"number": number})
        sent[number] = time.perf_counter()
        await ros.send_str(text.ljust(MESSAGE_BYTES))
    await asyncio.wait_for(receiving, last_s)


async def watch(port: int, setup: Setup) -> None:
    """Take frames, and note how old each is when it is whole."""
    await (watch_mjpeg(port, setup) if setup.codec is None else watch_frames(port, setup))


async def watch_mjpeg(port: int, setup: Setup) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(b"GET /stream?topic=/camera HTTP/1.1\r\nHost: robot\r\n\r\n")
        await reader.readuntil(b"\r\n\r\n")
        while True:
            head = await reader.readuntil(b"\r\n\r\n")
            timestamp, length = map(float, VALUES.findall(head))
            frame = await reader.readexactly(int(length))
            setup.frame_bytes += len(frame)
            setup.frame_ages_ms.append((time.time() - timestamp) * 1000)
            setup.codecs_seen.add(JPEG.name)
    finally:
        writer.close()


async def watch_frames(port: int, setup: Setup) -> None:
    """Take frames as the relay does, but with ages on the robot's clock."""
    url = f"ws://127.0.0.1:{port}{PATH}?topic=/camera"
    async with aiohttp.ClientSession() as http, http.ws_connect(url, max_msg_size=0) as socket:
        await socket.send_json({"op": "stream_request", "codecs": [setup.codec]})
        await socket.send_json({"op": "credit", "frames": MAX_CREDITS})
        async for message in socket:
            if message.type is not aiohttp.WSMsgType.BINARY:
                continue
            number, _, _, sequence, timestamp_ms = HEADER.unpack_from(message.data)
            setup.frame_ages_ms.append(robot_time() * 1000 - timestamp_ms)
            await socket.send_json({"op": "credit", "frames": 1, "taken": sequence})
            setup.frame_bytes += len(message.data) - HEADER.size
            setup.codecs_seen.add(CODECS[number].name)


def measure(seconds: float = SECONDS) -> Section:
    """Measure all ways, one after the other, and return them as a table."""
    measured = setups()
    measure_each(measured, UP, lambda site, setup: measure_setup(site, setup, seconds))
    return section(measured)


def measure_each(
    measured: Sequence[Setup],
    up: Shape,
    work: Callable[[Site, Setup], Coroutine[Any, Any, None]],
) -> None:
    """Do the work for each setup, over a link with that uplink."""
    if why := why_not_here():
        raise RuntimeError(f"cannot measure behind video: {why}")
    with TemporaryDirectory(prefix="rt-video-") as name, Link(up=up, down=DOWN) as link:
        link.robot.sysctl("net.ipv4.tcp_congestion_control", "cubic")
        with link.server.entered(), video_robot(link, Path(name), {}) as services:
            services.receive("that it serves", LAST_S)
            with Site(link, Path(name)) as site:
                for setup in measured:
                    with site.connected(setup.connections):
                        asyncio.run(work(site, setup))


def section(measured: list[Setup]) -> Section:
    text = (
        f"A {MESSAGE_BYTES}-byte message goes to the robot and back at {RATE_HZ} Hz over an emulated link: 38 ms, "
        f"{UP_MBIT_S} Mbit/s up, {DOWN_MBIT_S} Mbit/s down, queues of 256 KB. The camera pans slowly, and offers "
        f"{OFFERED_BIT_S / 1e6:g} Mbit/s of MJPEG in {FRAMES_HZ} frames a second. The robot's TCP is cubic. Guard and "
        "relay are not included; the table above has them.\n\n"
        "Aim: p50 under 60 ms and p99 under 100 ms with video."
    )
    return Section(
        "Round trip while video fills the uplink", text, [row(setup) for setup in measured]
    )


def row(setup: Setup) -> Row:
    trips, ages = setup.round_trips_ms, setup.frame_ages_ms
    columns = {
        "route": setup.name,
        "round trips": len(trips),
        **quantiles(trips, 0.5, 0.99, 1, unit="ms"),
    }
    if not ages:
        return columns
    return {
        **columns,
        # What came, whatever was requested.
        "codec": ", ".join(sorted(setup.codecs_seen)),
        "video Mbit/s": setup.frame_bytes * 8 / setup.lasted_s / 1e6,
        "frames/s": len(ages) / setup.lasted_s,
        **{f"frame age {name}": ms for name, ms in quantiles(ages, 0.5, 0.99, unit="ms").items()},
    }
