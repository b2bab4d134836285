"""Experiment 5: three operators drive three robots and look at their cameras, over each network of the paper's Table 2.

Each robot is behind a network of its own with the same profile, each operator behind a fixed line. One step is one
network and one quality, first one way and then the other with the same robots, so that what is compared was measured
side by side; which way is first takes turns. One more step a network has the range of qualities that a user has.
The ways are the whole stack, and a bare `ssh -R` as in the paper: one connection a robot for rosbridge and video, to an
sshd of its own on this machine that listens for operators on all addresses, as with GatewayPorts.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import (
    AbstractAsyncContextManager,
    AsyncExitStack,
    ExitStack,
    asynccontextmanager,
    contextmanager,
)
from dataclasses import dataclass
from functools import partial

import aiohttp
from bare_tunnel import bare_forward
from local_network import free_port, insecure_tls
from openssh_server import OpenSshServer
from video_viewers import OnFrame, view_frames, view_stream

from paper.client import Client, new_http
from paper.networks import FIXED, Profile, Uplink, made_in
from paper.operators.report import report
from paper.operators.run import (
    ADAPTIVE,
    FPS,
    NETWORKS,
    OURS,
    PLAIN,
    QUALITIES,
    ROBOTS,
    OperatorClient,
    Times,
    View,
    measured,
    step_name,
)
from paper.robots import (
    ROSBRIDGE_PORT,
    VIDEO_PORT,
    WholeRobot,
    wait_all_online,
)
from paper.step import Part, Scale, Step, Values
from paper.world import World

CAMERA = "/camera/image_raw"
ONLINE_WITHIN_S, CONNECTED_WITHIN_S = 60.0, 20.0
EVERYWHERE = "0.0.0.0"
USUAL, QUICK = Times(settle_s=5, measure_s=8), Times(settle_s=1.5, measure_s=4)
# What a robot's machine has where nobody chose; this machine's own default may be another.
CONGESTION_CONTROL = "cubic"


@dataclass(frozen=True)
class Pair:
    """A robot, and the uplink of who drives it."""

    robot: WholeRobot
    operator: Uplink


# Of a world, its pairs, and the JPEG quality; None leaves it to the sender, where it can.
Transport = Callable[
    [World, Sequence[Pair], int | None], AbstractAsyncContextManager[list[OperatorClient]]
]


@asynccontextmanager
async def ours(
    world: World, pairs: Sequence[Pair], quality: int | None
) -> AsyncIterator[list[OperatorClient]]:
    """Video by the frames protocol and commands by a drive session, both through the stack's nginx."""
    robots = [pair.robot for pair in pairs]
    wait_all_online(robots, ONLINE_WITHIN_S)
    async with AsyncExitStack() as stack:
        yield [await _our_client(stack, world, pair, quality) for pair in pairs]


async def _our_client(
    stack: AsyncExitStack, world: World, pair: Pair, quality: int | None
) -> OperatorClient:
    http = await stack.enter_async_context(http_behind(pair.operator))
    client = Client(http, world.address, world.token, CONNECTED_WITHIN_S)
    drive = await stack.enter_async_context(await client.connect(pair.robot.name))
    ticket = world.ticket(pair.robot.name, "observe")
    url = f"https://{world.address}/robots/{pair.robot.name}/video/frames?topic={CAMERA}&ticket={ticket}"
    stream_request: dict[str, int] = {"fps": FPS}
    if quality is not None:
        stream_request |= {"quality_min": quality, "quality_max": quality}

    async def view(on_frame: OnFrame) -> None:
        await view_frames(http, url, on_frame, stream_request, ssl=insecure_tls())

    return await _client(stack, pair, view, drive, local_view=None)


@asynccontextmanager
async def plain(
    world: World, pairs: Sequence[Pair], quality: int | None
) -> AsyncIterator[list[OperatorClient]]:
    """web_video_server's MJPEG and rosbridge itself, through one bare `ssh -R` a robot; no TLS, no guard."""
    async with AsyncExitStack() as stack:
        ports = stack.enter_context(bare_tunnels([pair.robot for pair in pairs]))
        clients = []
        for pair, (ros, video) in zip(pairs, ports, strict=True):
            http = await stack.enter_async_context(http_behind(pair.operator))
            machine = pair.operator.machine
            rosbridge = await stack.enter_async_context(
                http.ws_connect(f"ws://{machine}:{ros}/", compress=0)
            )
            view = stream(http, f"http://{machine}:{video}", quality)
            local = await stack.enter_async_context(http_behind(pair.robot.uplink))
            local_view = stream(local, pair.robot.video_url, quality)
            clients.append(await _client(stack, pair, view, rosbridge, local_view))
        yield clients


def stream(http: aiohttp.ClientSession, server: str, quality: int | None) -> View:
    """Look at the camera as web_video_server gives it."""
    wanted = "" if quality is None else f"&quality={quality}"
    return partial(view_stream, http, f"{server}/stream?topic={CAMERA}{wanted}")


def http_behind(uplink: Uplink) -> aiohttp.ClientSession:
    """Connections that are made in the uplink's network."""
    return new_http(**made_in(uplink.inside))


async def _client(
    stack: AsyncExitStack,
    pair: Pair,
    view: View,
    rosbridge: aiohttp.ClientWebSocketResponse,
    local_view: View | None,
) -> OperatorClient:
    local = await stack.enter_async_context(http_behind(pair.robot.uplink))
    subscriber = await stack.enter_async_context(
        local.ws_connect(pair.robot.ros_url, compress=0, max_msg_size=0)
    )
    return OperatorClient(
        robot=pair.robot.name,
        view=view,
        rosbridge=rosbridge,
        subscriber=subscriber,
        local_view=local_view,
        simulator_pid=pair.robot.ros_pid,
    )


@contextmanager
def bare_tunnels(robots: Sequence[WholeRobot]) -> Iterator[list[tuple[int, int]]]:
    """Connect each robot from its own network to this machine, besides what its agent has; ports of ROS and video."""
    with ExitStack() as stack:
        clients = stack.enter_context(ExitStack())
        # No session is opened, so that the relay behind sshd's session command is never asked.
        sshd = OpenSshServer(relay_port=0, address=EVERYWHERE)
        # It ends before its clients: what a robot's kernel holds of its video is then dropped, not sent for seconds.
        stack.callback(sshd.close)
        sshd.start()
        ports = [(free_port(), free_port()) for _ in robots]
        for number, (robot, (ros, video)) in enumerate(zip(robots, ports, strict=True), 1):
            forwards = {
                ros: f"{robot.address}:{ROSBRIDGE_PORT}",
                video: f"{robot.address}:{VIDEO_PORT}",
            }
            where = {"host": robot.uplink.machine, "inside": robot.uplink.inside}
            clients.enter_context(bare_forward(sshd, number, forwards, bind=EVERYWHERE, **where))
        yield ports


TRANSPORTS: Mapping[str, Transport] = {OURS: ours, PLAIN: plain}


def steps(scale: Scale) -> Sequence[Step]:
    """All of them, in the order of the paper's table."""
    if scale.quick:
        return [_step("4g-7", 50, (OURS,), QUICK), _step("4g-7", 90, (OURS, PLAIN), QUICK)]
    made = []
    for network in NETWORKS:
        for number, quality in enumerate(QUALITIES):
            transports = (OURS, PLAIN) if number % 2 == 0 else (PLAIN, OURS)
            made.append(_step(network, quality, transports, USUAL))
        made.append(_step(network, ADAPTIVE, (OURS,), USUAL))
    return made


def _step(network: str, quality: int | None, transports: Sequence[str], times: Times) -> Step:
    profile = NETWORKS[network]
    what = "the default range of qualities" if quality is None else f"quality {quality}"
    return Step(
        name=step_name(network, quality),
        title=f"{profile.name}, {what}",
        run=partial(run, profile=profile, quality=quality, transports=transports, times=times),
    )


def run(
    world: World, *, profile: Profile, quality: int | None, transports: Sequence[str], times: Times
) -> Values:
    """Measure each way, one after the other; the robots are made and removed here."""
    with robots_and_operators(world, profile) as pairs:
        return {
            transport: asyncio.run(_measure(world, pairs, TRANSPORTS[transport], quality, times))
            for transport in transports
        }


async def _measure(
    world: World, pairs: Sequence[Pair], transport: Transport, quality: int | None, times: Times
) -> Values:
    async with transport(world, pairs, quality) as clients:
        return await measured(clients, times)


@contextmanager
def robots_and_operators(world: World, profile: Profile) -> Iterator[list[Pair]]:
    """Three whole simulated robots behind such a network each, online, and a fixed line for each operator."""
    with ExitStack() as stack:
        enrolled = world.enrol(world.names("operators", ROBOTS))
        stack.callback(world.remove, enrolled)
        networks = stack.enter_context(world.uplinks([profile] * ROBOTS + [FIXED] * ROBOTS))
        homes, operators = networks[:ROBOTS], networks[ROBOTS:]
        robots = []
        for one, home in zip(enrolled, homes, strict=True):
            home.inside.sysctl("net.ipv4.tcp_congestion_control", CONGESTION_CONTROL)
            robots.append(stack.enter_context(WholeRobot(world, one, home, ros="simulator")))
        wait_all_online(robots, ONLINE_WITHIN_S)
        yield [Pair(*both) for both in zip(robots, operators, strict=True)]


PART = Part(
    name="operators",
    title="Operators with video",
    steps=steps,
    report=report,
)
