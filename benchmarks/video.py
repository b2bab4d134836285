"""How old a frame is at the viewer, and what viewers of one camera cost. Used by `bench`.

No frame may be left out: one whose timestamp cannot be read ends the run. `make demo` is needed, and root for links.
"""

from __future__ import annotations

import asyncio
import io
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import aiohttp
import pandas as pd
from bare_tunnel import bare_forward, bare_tunnel
from demo import Demo
from frame_stamp import read_stamp, stamp_of
from link import Link, Shape
from linked_robot import (
    FPS,
    SMALL_CAMERA,
    UP,
    UP_MBIT_S,
    VIDEO_PORT,
    WIDE_CAMERA,
    Address,
    emulated,
    linked_robot,
)
from local_network import free_port, insecure_tls
from paper.costs import use_of
from PIL import Image
from relay_server import until
from report import Row, Section, quantiles
from robotether_agent.clock import robot_time
from robotether_common.codecs import CODECS, JPEG, Codec
from robotether_common.frames import CREDITS, HEADER, KEY
from video_clips import Decoder

ROBOT, CAMERA = "sim1", "/camera/image_raw"
# Turns fast and has noise.
FAST_CAMERA = "/turret/image_raw"
# What viewers of the frames protocol say that they decode.
CODECS_VIEWED = ("jpeg", "h264")
SECONDS = 12.0
SETTLE_S = 5.0
STARTS_WITHIN_S = 30.0
AIM_LOOPBACK_MS, AIM_LINK_MS = 80, 250
# web_video_server's own default, which makes more than the link takes, and less, which fits.
PLAIN_QUALITIES = (95, 80)
# The paper's networks: Mbit/s down and up, and the delay there and back in ms.
NETWORKS = (
    (94, 89, 7),
    (288, 113, 7),
    (7.13, 4.97, 38),
    (31, 9, 19),
    (80, 19, 15),
    (5.4, 5.4, 31),
)
NARROW = (0.8, 0.8, 38)
# From the other side of the world.
FAR = (20, 20, 320)
COUNTS = (1, 5, 20)
VIEWERS_SECONDS, VIEWERS_SETTLE_S = 10.0, 3.0
RELAY_PORT = 8080
# One quality, so that no run has smaller frames than another; it makes frames of some 30 KB.
STREAM_REQUEST = {"quality_min": 75, "quality_max": 75, "fps": FPS, "latency_ms": 5000}
AIM_PERCENT = 5


@dataclass(frozen=True)
class Frame:
    """One frame, and the Unix time in s at which it was whole, before anything else was done with it.

    One that depends on others is decoded at once, in its turn.
    """

    received_at: float
    data: bytes
    # Of the frames protocol.
    sequence: int = 0
    codec: Codec = JPEG
    decoded: Image.Image | None = None
    # Unix time in s by the robot's clock, which is this machine's; None in a multipart stream.
    stamped_at: float | None = None

    @property
    def drawn_at(self) -> float:
        return read_stamp(self.data) if self.decoded is None else stamp_of(self.decoded)

    @property
    def age_ms(self) -> float:
        """How old what it shows was when it was whole; NoStampError when it does not tell."""
        return (self.received_at - self.drawn_at) * 1000

    @property
    def width(self) -> int:
        if self.decoded is not None:
            return self.decoded.width
        with Image.open(io.BytesIO(self.data)) as opened:
            return opened.width


class FrameReader:
    """Makes frames of one connection's messages; one that does not follow from those before it is an error."""

    def __init__(self) -> None:
        self._decoder: Decoder | None = None

    def read(self, received_at: float, message: bytes) -> Frame:
        number, flags, _, sequence, stamp_ms = HEADER.unpack_from(message)
        codec, data = CODECS[number], message[HEADER.size :]
        stamped_at = stamp_ms / 1000 + time.time() - robot_time()
        if not codec.depends_on_earlier:
            return Frame(received_at, data, sequence, stamped_at=stamped_at)
        # Another size is another sequence of frames, which begins with a key frame.
        if self._decoder is None or flags & KEY:
            self._decoder = Decoder(codec.name)
        image = Image.fromarray(self._decoder.decode(data))
        return Frame(received_at, data, sequence, codec, image, stamped_at)


OnFrame = Callable[[Frame], None]
# Looks until it is cancelled.
View = Callable[[aiohttp.ClientSession, OnFrame], Awaitable[None]]


def frames_url(address: Address, camera: str) -> str:
    return address(f"video/frames?topic={camera}&", "observe")


async def view_frames(
    http: aiohttp.ClientSession,
    on_frame: OnFrame,
    url: str,
    stream_request: Mapping[str, Any] | None = None,
    **how: Any,
) -> None:
    """Take frames by credit until the connection ends or the task is cancelled; `how` goes to ws_connect."""
    reader = FrameReader()
    async with http.ws_connect(url, compress=0, max_msg_size=0, **how) as socket:
        await socket.send_json({"op": "stream_request", **(stream_request or {})})
        await socket.send_json({"op": "credit", "frames": CREDITS})
        async for message in socket:
            if message.type is aiohttp.WSMsgType.BINARY:
                received_at = time.time()
                sequence = HEADER.unpack_from(message.data)[3]
                await socket.send_json({"op": "credit", "frames": 1, "taken": sequence})
                # In a thread, so that what this process measures beside need not wait for a decoder.
                on_frame(await asyncio.to_thread(reader.read, received_at, message.data))
        raise ConnectionError(f"the frames ended with {socket.close_code}")


async def view_stream(http: aiohttp.ClientSession, on_frame: OnFrame, url: str, **how: Any) -> None:
    """Take frames out of a multipart stream until it ends or the task is cancelled; `how` goes to get."""
    timeout = aiohttp.ClientTimeout(total=None)
    async with http.get(url, timeout=timeout, **how) as answer:
        answer.raise_for_status()
        length = 0
        async for line in answer.content:
            name, _, value = line.decode("ascii", "replace").partition(":")
            if name.lower() == "content-length":
                length = int(value)
            elif length and not line.strip():
                jpeg = await answer.content.readexactly(length)
                on_frame(Frame(time.time(), jpeg))
                length = 0
    raise ConnectionError("the stream ended")


@asynccontextmanager
async def going_on(
    works: Iterable[Awaitable[None]],
    have_begun: Callable[[], bool],
    what: str,
    within_s: float = STARTS_WITHIN_S,
) -> AsyncIterator[None]:
    """Works beside the block, which begins when all have begun; none may end before its end."""
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        await until(lambda: have_begun() or any(task.done() for task in tasks), what, within_s)
        yield
        for task in tasks:
            if task.done():
                task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@asynccontextmanager
async def looking(
    views: Sequence[View], what: str, within_s: float = STARTS_WITHIN_S
) -> AsyncIterator[list[list[Frame]]]:
    seen: list[list[Frame]] = [[] for _ in views]
    async with aiohttp.ClientSession() as http:
        works = [view(http, own.append) for view, own in zip(views, seen, strict=True)]
        async with going_on(works, lambda: all(seen), what, within_s):
            yield seen


async def viewed(
    where: str, transport: str, views: Sequence[View], seconds: float, camera: str = CAMERA
) -> Row:
    """Look for so long, all at once, after a while in which whatever fills up may fill up."""
    async with looking(views, f"a frame: {where}, {transport}") as seen:
        await asyncio.sleep(SETTLE_S)
        for own in seen:
            own.clear()
        await asyncio.sleep(seconds)
        frames = [list(own) for own in seen]
    if min(map(len, frames)) < 2:
        raise RuntimeError(f"cannot measure {transport}, {where}: too few frames came")
    row = await asyncio.to_thread(frames_row, frames, seconds)
    return {"where": where, "camera": camera, "route": transport, **row}


def frames_row(frames: Sequence[Sequence[Frame]], seconds: float) -> Row:
    """What viewers saw in so many seconds; rates are of one."""
    together = [frame for own in frames for frame in own]
    size, viewed_s = sum(len(frame.data) for frame in together), len(frames) * seconds
    return {
        # What came, whatever was requested.
        "codec": ", ".join(sorted({frame.codec.name for frame in together})),
        "frames": len(together),
        **quantiles([frame.age_ms for frame in together], 0.5, 0.95, 1, unit="ms"),
        "frames/s": len(together) / viewed_s,
        "pixels wide": sum(frame.width for frame in together) / len(together),
        "KB a frame": size / len(together) / 1000,
        "Mbit/s": size * 8 / viewed_s / 1e6,
    }


def demo_address(demo: Demo) -> Address:
    def address(path: str, mode: str) -> str:
        return f"{demo.url}/robots/{ROBOT}/{path}ticket={demo.ticket(ROBOT, mode)}"

    return address


async def on_loopback(demo: Demo, seconds: float) -> list[Row]:
    where = "loopback"
    rows = await ours_viewed(where, demo_address(demo), seconds, {}, ssl=insecure_tls())
    with bare_tunnel(f"{demo.address_of(ROBOT)}:{VIDEO_PORT}") as port:
        return [*rows, await plain_viewed(where, [port], PLAIN_QUALITIES[0], seconds)]


async def plain_viewed(
    where: str, ports: Sequence[int], quality: int, seconds: float, camera: str = CAMERA
) -> Row:
    path = f"stream?topic={camera}&quality={quality}"
    views = [partial(view_stream, url=f"http://127.0.0.1:{port}/{path}") for port in ports]
    name = f"plain MJPEG, quality {quality}, bare ssh -R"
    return await viewed(where, name, views, seconds, camera)


async def ours_viewed(
    where: str, address: Address, seconds: float, request: Mapping[str, int], **how: Any
) -> list[Row]:
    """Look at each camera by each codec, and at one by the stream for players, which nothing may be requested of."""

    def frames_view(camera: str, codec: str) -> View:
        wanted = {**request, "codecs": [codec]}
        # Each time with a fresh ticket.
        return lambda http, on_frame: view_frames(
            http, on_frame, frames_url(address, camera), wanted, **how
        )

    await until_seen(frames_view(CAMERA, CODECS_VIEWED[0]))
    rows = [
        await viewed(where, "Robotether, frames", [frames_view(camera, codec)], seconds, camera)
        for camera in (CAMERA, FAST_CAMERA)
        for codec in CODECS_VIEWED
    ]
    if not request:
        stream = address(f"video/stream?topic={CAMERA}&", "observe")
        view = partial(view_stream, url=stream, **how)
        rows.append(await viewed(where, "Robotether, multipart stream", [view], seconds))
    return rows


async def over_link(
    link: Link,
    where: str,
    seconds: float,
    request: Mapping[str, int],
    qualities: Sequence[int] = (),
) -> list[Row]:
    """Look at the cameras of a robot behind the link, and at the first by plain MJPEG of these qualities."""
    async with linked_robot(link, {**SMALL_CAMERA, **request}) as (site, subject):
        address = site.address_of(subject.robot)
        rows = await ours_viewed(where, address, seconds, request)
        for quality in qualities:
            port = free_port()
            forward = {port: f"127.0.0.1:{VIDEO_PORT}"}
            with bare_forward(site.sshd, 2, forward, host=site.sshd.address, inside=link.robot):
                rows.append(await plain_viewed(where, [port], quality, seconds))
        return rows


def shape_of(mbit_s: float, delay_ms: float) -> Shape:
    return Shape(rate_bit_s=mbit_s * 1e6, delay_s=delay_ms / 2000, queue_bytes=UP.queue_bytes)


def measure_networks(seconds: float = SECONDS) -> Section:
    """Measure what H.264 is for, a large picture and a narrow line, and a long way."""
    rows: list[Row] = []
    for (down, up, delay_ms), what, request in (
        (NETWORKS[2], ", 1280x720 at 25/s", WIDE_CAMERA),
        (NARROW, "", {"fps": FPS}),
        (FAR, "", {"fps": FPS}),
    ):
        where = f"{down:g}/{up:g} Mbit/s, {delay_ms:g} ms{what}"
        with emulated(shape_of(up, delay_ms), shape_of(down, delay_ms)) as link:
            rows += asyncio.run(over_link(link, where, seconds, request))
    return Section(
        title="Age of a large frame, on a narrow line, and from far away, by codec",
        text=(
            "As over the link above, with one robot at a time: Mbit/s down and up, and the delay there and back. "
            f"{FAST_CAMERA} turns fast and has noise.\n\n"
            f"Aim: 1280x720 at 25/s p95 120 ms by H.264; at 0.8 Mbit/s 640x480 at {FPS}/s, whose PSNR at those bits "
            "the codecs' table has."
        ),
        rows=rows,
    )


async def until_seen(view: View) -> None:
    """Look again and again until a first frame comes: the robot may still be on its way."""
    deadline = time.monotonic() + STARTS_WITHIN_S
    while time.monotonic() < deadline:
        with suppress(AssertionError, aiohttp.ClientError, OSError):
            async with looking([view], "a frame", 2.0) as [seen]:
                if seen:
                    return
        await asyncio.sleep(0.1)
    raise RuntimeError(f"cannot measure: no frame in {STARTS_WITHIN_S:g} s")


def measure_age(demo: Demo, seconds: float = SECONDS) -> Section:
    rows = asyncio.run(on_loopback(demo, seconds))
    with emulated() as link:
        where = f"38 ms, {UP_MBIT_S} Mbit/s up"
        rows += asyncio.run(over_link(link, where, seconds, {}, PLAIN_QUALITIES))
    return Section(
        title="Age of a frame at the viewer",
        text=(
            "The age is from the timestamp that the simulated camera draws into its 640x480 frame until a viewer has "
            f"the whole frame. {FAST_CAMERA} turns fast and has noise. Each row took {seconds:g} s, from {SETTLE_S:g} "
            "s after the first frame. Drawing and encoding are included, decoding and the pause between frames are "
            "not. Loopback is the whole demo, with nginx and TLS. Over the link the viewer is beside the relay, "
            "without these two, and the robot's TCP is cubic. Plain MJPEG of quality 95 (web_video_server's default) "
            "is more than the link carries, so its age grows with time.\n\n"
            f"Aim: p95 under {AIM_LOOPBACK_MS} ms on loopback and under {AIM_LINK_MS} ms over the link."
        ),
        rows=rows,
    )


class Usage:
    def __init__(self, demo: Demo) -> None:
        self._relay, self._robot = demo.container("relay"), demo.container(ROBOT)

    def relay_cpu_s(self) -> float:
        return use_of(self._relay).cpu_s

    def uplink_bytes(self) -> int:
        lines = Path(f"/proc/{self._robot.attrs['State']['Pid']}/net/dev").read_text().splitlines()
        [counts] = [line.split() for line in lines if line.strip().startswith("eth0:")]
        return int(counts[9])


def beside_relay(demo: Demo) -> View:
    address = f"http://{demo.address_of('relay')}:{RELAY_PORT}/robots/{ROBOT}/video/frames"
    url = f"{address}?topic={CAMERA}&ticket={demo.ticket(ROBOT, 'observe')}"
    return partial(view_frames, url=url, stream_request=STREAM_REQUEST)


async def run(demo: Demo, viewers: int, seconds: float) -> Row:
    usage = Usage(demo)
    views = [beside_relay(demo) for _ in range(viewers)]
    async with looking(views, f"a frame for each of {viewers}") as seen:
        await asyncio.sleep(VIEWERS_SETTLE_S)
        for own in seen:
            own.clear()
        cpu_s, uplink = usage.relay_cpu_s(), usage.uplink_bytes()
        started = time.monotonic()
        await asyncio.sleep(seconds)
        frames = [frame for own in seen for frame in own]
        lasted_s, uplink = time.monotonic() - started, usage.uplink_bytes() - uplink
        cpu_s = usage.relay_cpu_s() - cpu_s
    per_100 = cpu_s / len(frames) * 100 * 100
    return {
        "viewers": viewers,
        "frames/s each": len(frames) / viewers / lasted_s,
        "KB a frame": sum(len(frame.data) for frame in frames) / len(frames) / 1000,
        "robot's uplink KB/s": uplink / lasted_s / 1000,
        "relay, % of a core": cpu_s / lasted_s * 100,
        "relay, % of a core for 100 frames/s": per_100,
        "viewers a core at 15 fps": 100 * 100 / per_100 / FPS,
    }


def measure_viewers(demo: Demo, seconds: float = VIEWERS_SECONDS) -> Section:
    table = pd.DataFrame([asyncio.run(run(demo, viewers, seconds)) for viewers in COUNTS])
    uplink = table["robot's uplink KB/s"]
    table["uplink, % more than for one"] = (uplink / uplink.iloc[0] - 1) * 100
    return Section(
        title="What viewers cost the robot's uplink and the relay",
        text=(
            f"One camera of 640x480 at {FPS} frames a second and quality 75, {seconds:g} s a row. All that leaves the "
            "robot counts, and all of the relay's processor time, when idle too. Viewers connect to the relay itself, "
            "without nginx and TLS.\n\n"
            f"Aim: the uplink stays the same within {AIM_PERCENT} %."
        ),
        rows=table,
    )
