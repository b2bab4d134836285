"""How long control takes while video, a map or topics fill the robot's uplink. Used by `bench`; needs root.

What fills the link (linked_robot.py) is a camera of the simulator, and topics that this process publishes at its
rosbridge. No sample may be dropped: one that is still out at the end is waited for.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

import aiohttp
from bare_tunnel import bare_forward
from link import Link, Shape
from linked_robot import (
    FPS,
    ROS_PORT,
    UP,
    UP_MBIT_S,
    VIDEO_PORT,
    Address,
    Site,
    Subject,
    emulated,
    linked_robot,
)
from local_network import free_port
from relay_server import until
from report import Row, Section, quantiles
from robotether_server.recorder.observer import KEY_FRAME_EVERY_S, CameraObserver
from round_trip import made_in
from video import (
    CODECS_VIEWED,
    FAST_CAMERA,
    Frame,
    frames_url,
    going_on,
    view_frames,
    view_stream,
)

RATE_HZ = 20
SECONDS, BULK_SECONDS = 30.0, 25.0
# Until what fills the link has filled it.
SETTLE_S = 5.0
# Time limit for the last answer, which may have a map before it, and for the map.
LAST_WITHIN_S, MAP_WITHIN_S = 60.0, 180.0
NARROW_MBIT_S = 1.0
NARROW = Shape(rate_bit_s=NARROW_MBIT_S * 1e6, delay_s=UP.delay_s, queue_bytes=UP.queue_bytes)
LATE_MS = 500.0
TYPE = "std_msgs/String"
# The answer comes, as the call goes, on the connection that drives.
CALL = {"op": "call_service", "service": "/rosapi/topic_type", "args": {"topic": "/cmd_vel"}}
# What web_video_server would give, at the quality that the agent's frames begin with.
PLAIN, PLAIN_QUALITY = "plain MJPEG", 80
RECORDER = "recorder"
TRIP = (
    "A call goes to the robot and its answer comes back on the connection that drives, "
    f"{RATE_HZ} times a second over an emulated link: "
)


@dataclass(frozen=True)
class Topic:
    name: str
    size: int
    rate_hz: float = 0.0


# Of 1500 x 1500 cells, as rosbridge writes it; a laser; a PointCloud2.
MAP = Topic("/map_of_5_mb", 5_000_000)
SCAN, CLOUD = Topic("/laser", 2_500, 40), Topic("/points", 1_000_000, 2)


@dataclass
class Setup:
    """One way to connect the robot and what comes on it, and what was measured."""

    name: str
    # Number of bare SSH connections; 0: those of the agent.
    bare: int = 0
    # PLAIN or a codec of the frames protocol; empty: none.
    video: str = ""
    # Who else looks: RECORDER, which requests key frames, or who decodes a codec alone.
    beside: str = ""
    topics: Sequence[Topic] = ()
    trips_ms: list[float] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    # By topic: when the first whole message was sent; when messages came, and their sizes. Moments are Unix times in s.
    sent_at: dict[str, float] = field(default_factory=dict)
    messages: dict[str, list[tuple[float, int]]] = field(default_factory=dict)
    # From the first round trip to the last.
    began_at: float = 0.0
    ended_at: float = 0.0

    @property
    def lasted_s(self) -> float:
        return self.ended_at - self.began_at

    def counts(self, at: float) -> bool:
        return self.began_at <= at <= self.ended_at

    def first_s(self, topic: Topic) -> float | None:
        came = (at for at, size in self.messages[topic.name] if size >= topic.size)
        return next((at - self.sent_at[topic.name] for at in came), None)

    @property
    def row(self) -> Row:
        columns = {
            "route": self.name,
            "round trips": len(self.trips_ms),
            **quantiles(self.trips_ms, 0.5, 0.99, 1, unit="ms"),
        }
        if not self.video:
            return columns
        frames = [frame for frame in self.frames if self.counts(frame.received_at)]
        if not frames:
            raise RuntimeError(f"cannot measure {self.name}: no frame came")
        # A small frame shows no time that can be read.
        ages = quantiles(
            [
                frame.age_ms
                if frame.stamped_at is None
                else (frame.received_at - frame.stamped_at) * 1000
                for frame in frames
            ],
            *(0.5, 0.99),
            unit="ms",
        )
        return {
            **columns,
            # What came, whatever was requested.
            "codec": ", ".join(sorted({frame.codec.name for frame in frames})),
            "video Mbit/s": self.mbit_s(len(frame.data) for frame in frames),
            "frames/s": len(frames) / self.lasted_s,
            **{f"frame age {name}": ms for name, ms in ages.items()},
        }

    def mbit_s(self, sizes: Iterable[int]) -> float:
        return sum(sizes) * 8 / self.lasted_s / 1e6


@contextmanager
def address_by(link: Link, site: Site, subject: Subject, bare: int) -> Iterator[Address]:
    """Addresses of what the robot has, through so many bare connections or through the agent's."""
    if not bare:
        yield site.address_of(subject.robot)
        return
    ports = {"ros": (free_port(), ROS_PORT), "video": (free_port(), VIDEO_PORT)}
    forwards = [{here: f"127.0.0.1:{there}"} for here, there in ports.values()]
    with ExitStack() as stack:
        for number, some in enumerate(forwards if bare > 1 else [forwards[0] | forwards[1]], 2):
            stack.enter_context(
                bare_forward(site.sshd, number, some, host=site.sshd.address, inside=link.robot)
            )

        def address(path: str, _mode: str) -> str:
            what, _, rest = path.partition("/" if path.startswith("video") else "?")
            return f"http://127.0.0.1:{ports[what][0]}/{rest}"

        yield address


async def publish(link: Link, topic: Topic, setup: Setup) -> None:
    """Publish at the robot's own rosbridge, from its network: little until somebody hears it, then all."""
    connector = aiohttp.TCPConnector(**made_in(link.robot))
    async with (
        aiohttp.ClientSession(connector=connector) as http,
        http.ws_connect(f"ws://127.0.0.1:{ROS_PORT}/", compress=0) as socket,
    ):
        await socket.send_json({"op": "advertise", "topic": topic.name, "type": TYPE})
        small, whole = (
            {"op": "publish", "topic": topic.name, "msg": {"data": "x" * size}}
            for size in (1, topic.size)
        )
        while topic.name not in setup.messages:
            await socket.send_json(small)
            await asyncio.sleep(0.2)
        started = setup.sent_at[topic.name] = time.time()
        await socket.send_json(whole)
        number = 0
        while topic.rate_hz:
            number += 1
            await asyncio.sleep(max(0.0, started + number / topic.rate_hz - time.time()))
            await socket.send_json(whole)
        await asyncio.Event().wait()


async def observe(
    http: aiohttp.ClientSession, address: Address, topic: Topic, setup: Setup
) -> None:
    url = address("ros?", "observe")
    async with http.ws_connect(url, compress=0, max_msg_size=0) as observer:
        await observer.send_json({"op": "subscribe", "topic": topic.name, "type": TYPE})
        async for message in observer:
            came = setup.messages.setdefault(topic.name, [])
            came.append((time.time(), len(message.data)))
    raise ConnectionError(f"{topic.name} ended with {observer.close_code}")


async def watch(http: aiohttp.ClientSession, address: Address, setup: Setup) -> None:
    if setup.video == PLAIN:
        url = address(f"video/stream?topic={FAST_CAMERA}&quality={PLAIN_QUALITY}&", "observe")
        await view_stream(http, setup.frames.append, url)
    else:
        url = frames_url(address, FAST_CAMERA)
        await view_frames(http, setup.frames.append, url, {"codecs": [setup.video]})


async def view_beside(http: aiohttp.ClientSession, address: Address, who: str) -> None:
    url = frames_url(address, FAST_CAMERA)
    if who != RECORDER:
        await view_frames(http, lambda _frame: None, url, {"codecs": [who]})
        return
    async with http.ws_connect(url, compress=0, max_msg_size=0) as socket:
        await CameraObserver(socket, FAST_CAMERA, lambda _message: None).run()


async def round_trips(socket: aiohttp.ClientWebSocketResponse, setup: Setup, count: int) -> None:
    sent_s: dict[str, float] = {}

    async def take_answers() -> None:
        while len(setup.trips_ms) < count:
            said = json.loads(await socket.receive_str())
            if said.get("op") == "service_response":
                setup.trips_ms.append((time.perf_counter() - sent_s[said["id"]]) * 1000)

    receiving = asyncio.ensure_future(take_answers())
    await asyncio.sleep(SETTLE_S)
    setup.began_at, started = time.time(), time.perf_counter()
    for number in range(count):
        await asyncio.sleep(started + number / RATE_HZ - time.perf_counter())
        sent_s[str(number)] = time.perf_counter()
        await socket.send_json({**CALL, "id": str(number)})
    setup.ended_at = time.time()
    await asyncio.wait_for(receiving, LAST_WITHIN_S)


async def measure_setup(link: Link, address: Address, setup: Setup, seconds: float) -> None:
    async with aiohttp.ClientSession() as http:
        works = [publish(link, topic, setup) for topic in setup.topics]
        works += [observe(http, address, topic, setup) for topic in setup.topics]
        works += [watch(http, address, setup)] if setup.video else []
        works += [view_beside(http, address, setup.beside)] if setup.beside else []

        def have_begun() -> bool:
            return len(setup.sent_at) == len(setup.topics) and bool(setup.frames or not setup.video)

        url = address("ros?", "drive")
        async with (
            going_on(works, have_begun, f"all that {setup.name} brings"),
            http.ws_connect(url, compress=0) as socket,
        ):
            await round_trips(socket, setup, int(seconds * RATE_HZ))
            # The map may be on its way still.
            for topic in setup.topics:
                await until(lambda: setup.first_s(topic), topic.name, MAP_WITHIN_S)  # noqa: B023 (now)


async def measure_all(link: Link, setups: Sequence[Setup], seconds: float) -> None:
    async with linked_robot(link) as (site, subject):
        await subject.until_drivable()
        for setup in setups:
            with address_by(link, site, subject, setup.bare) as address:
                await measure_setup(link, address, setup, seconds)


def measured(setups: Sequence[Setup], seconds: float, up: Shape = UP) -> Sequence[Setup]:
    with emulated(up) as link:
        asyncio.run(measure_all(link, setups, seconds))
    return setups


def measure(seconds: float = SECONDS) -> Section:
    setups = [
        Setup("one ssh -R, as in the paper", bare=1, video=PLAIN),
        Setup("two ssh -R", bare=2, video=PLAIN),
        *(Setup(f"Robotether, {codec}", video=codec) for codec in CODECS_VIEWED),
        Setup("Robotether, h264, recorded", video="h264", beside=RECORDER),
        Setup("Robotether, h264 beside a viewer of JPEG", video="h264", beside="jpeg"),
        Setup("Robotether, no video"),
    ]
    text = (
        f"{TRIP}38 ms, {UP_MBIT_S} Mbit/s up, queues of 256 KB. {FAST_CAMERA} turns fast and has noise: at "
        f"quality {PLAIN_QUALITY} its {FPS} frames a second are more than the link takes. Agent, guard and relay "
        "are included, nginx and TLS are not. The robot's TCP is cubic. What reads to record requests a key frame each "
        f"{KEY_FRAME_EVERY_S:g} s.\n\n"
        "Aim: p50 under 60 ms and p99 under 100 ms with video."
    )
    rows = [setup.row for setup in measured(setups, seconds)]
    return Section("Round trip while video fills the uplink", text, rows)


def measure_bulk(seconds: float = BULK_SECONDS) -> Section:
    setups = [
        Setup("one ssh -R, as in the paper", bare=1, topics=[MAP]),
        Setup("Robotether", topics=[MAP]),
    ]
    text = (
        f"{TRIP}38 ms, {NARROW_MBIT_S:g} Mbit/s up, while an observer's subscription brings a message of "
        f"{MAP.size / 1e6:g} MB. Agent, guard and relay are included. Late is over {LATE_MS:g} ms: the guard "
        "drops a command that is as old, and its deadman stops the robot.\n\n"
        "Aim: no late call, p99 under 250 ms, and the map within twice its share of the line."
    )
    rows = [
        {
            **setup.row,
            "late": sum(trip > LATE_MS for trip in setup.trips_ms),
            "map in s": map_s,
            "share of the line": map_s and MAP.size * 8 / map_s / (NARROW_MBIT_S * 1e6),
        }
        for setup in measured(setups, seconds, NARROW)
        for map_s in [setup.first_s(MAP)]
    ]
    return Section("Round trip while a map fills the uplink", text, rows)


def measure_mixed(seconds: float = SECONDS) -> Section:
    topics = [SCAN, CLOUD]
    setups = [Setup(f"Robotether, {codec}", video=codec, topics=topics) for codec in CODECS_VIEWED]
    text = (
        f"As behind_video, and the robot has a topic of {SCAN.size / 1e3:g} KB at {SCAN.rate_hz} Hz, as a laser's, and "
        f"one of {CLOUD.size / 1e6:g} MB at {CLOUD.rate_hz} Hz, as a PointCloud2, each with an observer.\n\n"
        "Aim: p99 60 ms and 8 frames a second or more."
    )
    return Section(
        "Round trip while video and topics fill the uplink",
        text,
        [mixed_row(setup) for setup in measured(setups, seconds)],
    )


def mixed_row(setup: Setup) -> Row:
    sizes = {
        name: [size for at, size in came if setup.counts(at)]
        for name, came in setup.messages.items()
    }
    rates = {f"{name} a second": len(some) / setup.lasted_s for name, some in sizes.items()}
    everything = (size for some in sizes.values() for size in some)
    return {**setup.row, **rates, "topics Mbit/s": setup.mbit_s(everything)}
