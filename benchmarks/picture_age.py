"""How old a frame is at the viewer, by the timestamp that the simulated camera has drawn into it.

On loopback over the whole demo, and over an emulated link like the worst of the paper's (link.py) with the real agent,
OpenSSH and relay; each beside plain MJPEG through a bare `ssh -R` over the same. Used by `bench`; needs `make demo` and
root. No picture may be left out: one whose moment cannot be read ends the run.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import aiohttp
from bare_tunnel import BareTunnel
from behind_video import DOWN, UP, UP_MBIT_S, running
from demo import Demo
from link import Link, why_not_here
from local_network import free_port, insecure_tls
from namespaces import Namespace
from openssh_server import OpenSshServer, listens
from recovery import Site, Subject
from relay_server import SESSION_KEY, MemoryDatabase, running_relay, until
from robotether_server.relay.main import Timing
from sections import Section, quantile
from video_viewers import Frame, OnFrame, view_frames, view_stream

SIM_ROBOT = Path(__file__).resolve().parents[1] / "images" / "sim_robot"
ROBOT, CAMERA = "sim1", "/camera/image_raw"
SECONDS = 12.0
SETTLE_S = 5.0
STARTS_WITHIN_S = 30.0
AIM_LOOPBACK_MS, AIM_LINK_MS = 80, 250
# web_video_server's own default, which makes more than the link takes, and less, which fits.
PLAIN_QUALITIES = (95, 80)


@dataclass(frozen=True)
class Row:
    """What was seen on one route."""

    where: str
    transport: str
    viewed_frames: list[Frame]
    lasted_s: float

    @property
    def line(self) -> str:
        """The row of the table."""
        ages = [frame.age_ms for frame in self.viewed_frames]
        size = sum(len(frame.jpeg) for frame in self.viewed_frames)
        return (
            f"| {self.where} | {self.transport} | {len(ages)} | {quantile(ages, 0.5):.0f} "
            f"| {quantile(ages, 0.95):.0f} | {max(ages):.0f} | {len(ages) / self.lasted_s:.1f} "
            f"| {size / len(ages) / 1000:.0f} | {size * 8 / self.lasted_s / 1e6:.2f} |"
        )


# Looks until it is cancelled.
View = Callable[[aiohttp.ClientSession, OnFrame], Awaitable[None]]


async def viewed(where: str, transport: str, view: View, seconds: float) -> Row:
    """Look for so long, after a while in which whatever fills up may fill up."""
    seen: list[Frame] = []
    async with aiohttp.ClientSession() as http:
        looking = asyncio.ensure_future(view(http, seen.append))
        try:
            await until(
                lambda: seen or looking.done(), f"a picture: {where}, {transport}", STARTS_WITHIN_S
            )
            await asyncio.wait([looking], timeout=SETTLE_S)
            seen.clear()
            await asyncio.wait([looking], timeout=seconds)
            if looking.done():
                looking.result()
            if len(seen) < 2:
                raise RuntimeError(f"cannot measure {transport}, {where}: {len(seen)} frames came")
            return Row(where, transport, list(seen), seconds)
        finally:
            looking.cancel()
            await asyncio.gather(looking, return_exceptions=True)


async def on_loopback(demo: Demo, seconds: float) -> list[Row]:
    """The demo's robot as a viewer outside sees it."""
    where, tls = "loopback", {"ssl": insecure_tls()}
    base = f"{demo.url}/robots/{ROBOT}/video"

    async def frames(http: aiohttp.ClientSession, on_frame: OnFrame) -> None:
        ticket = await asyncio.to_thread(demo.ticket, ROBOT, "observe")
        await view_frames(http, f"{base}/frames?topic={CAMERA}&ticket={ticket}", on_frame, **tls)

    async def stream(http: aiohttp.ClientSession, on_frame: OnFrame) -> None:
        bearer = {"Authorization": f"Bearer {demo.token}"}
        await view_stream(http, f"{base}/stream?topic={CAMERA}", on_frame, headers=bearer, **tls)

    rows = [
        await viewed(where, "Robotether, frames protocol", frames, seconds),
        await viewed(where, "Robotether, multipart stream", stream, seconds),
    ]
    with BareTunnel(demo.address_of(ROBOT), 8080) as bare:
        view = plain(bare.port, PLAIN_QUALITIES[0])
        rows.append(await viewed(where, plain_name(PLAIN_QUALITIES[0]), view, seconds))
    return rows


def plain(port: int, quality: int) -> View:
    """MJPEG as web_video_server gives it."""

    async def view(http: aiohttp.ClientSession, on_frame: OnFrame) -> None:
        url = f"http://127.0.0.1:{port}/stream?topic={CAMERA}&quality={quality}"
        await view_stream(http, url, on_frame)

    return view


def plain_name(quality: int) -> str:
    """Name such a route."""
    return f"plain MJPEG, quality {quality}, bare ssh -R"


@dataclass(frozen=True)
class Uplink:
    """The robot's network as recovery's agents know theirs."""

    server: str
    robot: Namespace


async def over_link(link: Link, seconds: float) -> list[Row]:
    """A robot behind the link; this thread must be in the server's namespace."""
    where = f"38 ms, {UP_MBIT_S} Mbit/s up"
    async with linked_robot(link) as (site, subject):
        relay, robot = site.relay, subject.robot

        def url(what: str) -> str:
            ticket = relay.ticket(robot, "observe")
            return f"{relay.url}/robots/{robot.name}/video/{what}?topic={CAMERA}&ticket={ticket}"

        async def frames(http: aiohttp.ClientSession, on_frame: OnFrame) -> None:
            await view_frames(http, url("frames"), on_frame)

        async def stream(http: aiohttp.ClientSession, on_frame: OnFrame) -> None:
            await view_stream(http, url("stream"), on_frame)

        await until_seen(frames)
        rows = [
            await viewed(where, "Robotether, frames protocol", frames, seconds),
            await viewed(where, "Robotether, multipart stream", stream, seconds),
        ]
        for quality in PLAIN_QUALITIES:
            with bare_forward(link, site.sshd) as port:
                await until(lambda port=port: listens(port), "the bare forward stands")
                rows.append(await viewed(where, plain_name(quality), plain(port, quality), seconds))
    return rows


async def until_seen(view: View) -> None:
    """Look again and again until a first picture comes: the robot may still be on its way."""
    seen: list[Frame] = []
    deadline = asyncio.get_running_loop().time() + STARTS_WITHIN_S
    while not seen:
        if asyncio.get_running_loop().time() > deadline:
            raise RuntimeError(f"cannot measure: no frame in {STARTS_WITHIN_S:g} s")
        async with aiohttp.ClientSession() as http:
            looking = asyncio.ensure_future(view(http, seen.append))
            with suppress(AssertionError):
                await until(lambda looking=looking: seen or looking.done(), "a picture", 2.0)
            looking.cancel()
            await asyncio.gather(looking, return_exceptions=True)


@asynccontextmanager
async def linked_robot(link: Link) -> AsyncIterator[tuple[Site, Subject]]:
    """Real relay and sshd at the server's end of the link, real agent and the simulator at the robot's."""
    async with AsyncExitStack() as stack:
        records = MemoryDatabase()
        robot = records.add_robot(1, ROBOT, u1="drive")
        relay = await stack.enter_async_context(running_relay(records, Timing()))
        sshd = OpenSshServer(
            relay.relay.session_port, address=link.server.address, session_key=SESSION_KEY
        )
        stack.callback(sshd.close)
        await asyncio.to_thread(sshd.start)
        http = await stack.enter_async_context(aiohttp.ClientSession())
        stack.enter_context(simulator(link.robot))
        site = Site(relay, records, sshd, http)
        folder = Path(tempfile.mkdtemp(prefix="rt-"))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        subject = Subject(site, Uplink(link.server.address, link.robot), robot, folder, {})
        stack.callback(subject.close)
        await subject.enrol()
        subject.start_agent()
        yield site, subject


@contextmanager
def simulator(robot: Namespace) -> Iterator[None]:
    """The simulated robot in its own network."""
    command = robot.command(sys.executable, "-m", "sim_robot")
    given = {"PYTHONPATH": str(SIM_ROBOT), "SIM_NAME": ROBOT, "SIM_BIND_ADDRESS": "127.0.0.1"}
    with subprocess.Popen(
        command, env={**os.environ, **given, "SIM_LOG_LEVEL": "error"}
    ) as process:
        try:
            yield
        finally:
            process.terminate()


@contextmanager
def bare_forward(link: Link, sshd: OpenSshServer) -> Iterator[int]:
    """The robot's video port through a bare `ssh -R` over the link; gives its port at the server."""
    port = free_port()
    with tempfile.TemporaryDirectory(prefix="rt-bare-") as folder:
        key = Path(folder) / "key"
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
        sshd.authorize_too(key.with_suffix(".pub").read_text().strip(), (port,), 2)
        options = ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "LogLevel=ERROR")
        words = ["ssh", "-F", "none", "-N", "-i", str(key), "-p", str(sshd.port)]
        words += [word for option in options for word in ("-o", option)]
        words += ["-R", f"127.0.0.1:{port}:127.0.0.1:8080", f"{sshd.user}@{sshd.address}"]
        with running(link.robot.command(*words)):
            yield port


def measure(demo: Demo, seconds: float = SECONDS) -> Section:
    """Measure all routes, and return them as a table."""
    if why := why_not_here():
        raise RuntimeError(f"cannot measure the age of frames over a link: {why}")
    rows = asyncio.run(on_loopback(demo, seconds))
    with Link(up=UP, down=DOWN) as link:
        link.robot.sysctl("net.ipv4.tcp_congestion_control", "cubic")
        with link.server.entered():
            rows += asyncio.run(over_link(link, seconds))
    return Section(
        title="Age of a frame at the viewer",
        text=(
            "The age is from the timestamp that the simulated camera draws into its 640x480 frame until a viewer has "
            f"the whole frame. Each row took {seconds:g} s, from {SETTLE_S:g} s after the first frame. Drawing and "
            "encoding are included, the pause between frames is not. Loopback is the whole demo, with nginx and TLS. "
            "Over the link the viewer is beside the relay, without these two, and the robot's TCP is cubic. Plain "
            "MJPEG of quality 95 (web_video_server's default) is more than the link carries, so its age grows with "
            "time.\n\n"
            f"Aim: p95 under {AIM_LOOPBACK_MS} ms on loopback and under {AIM_LINK_MS} ms over the link."
        ),
        table=[
            "| where | route | frames | p50 ms | p95 ms | max ms | frames/s | KB a frame | Mbit/s |",
            "|---|---|---|---|---|---|---|---|---|",
            *(row.line for row in rows),
        ],
    )
