"""Both ways to sit at a robot that the operators' experiment compares: the whole stack, and a bare `ssh -R`.

Each gives seats for as long as it is entered, with the same robots. Nothing else goes on in this process until all have
their seats, so that it may wait here.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

import aiohttp
from local_network import insecure_tls
from video_viewers import OnFrame, view_frames, view_stream

from paper.operator import Operator, connector
from paper.operators_bare import bare_tunnels
from paper.operators_plan import FPS
from paper.operators_run import OperatorClient, View
from paper.robots import WholeRobot, wait_all_online
from paper.uplinks import Uplink
from paper.world import World

CAMERA = "/camera/image_raw"
ONLINE_WITHIN_S = 60.0


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
    operator = Operator(http, world, pair.operator, pair.robot.name)
    await stack.enter_async_context(operator)
    ticket = world.ticket(pair.robot.name, "observe")
    url = f"https://{world.address}/robots/{pair.robot.name}/video/frames?topic={CAMERA}&ticket={ticket}"
    stream_request: dict[str, int] = {"fps": FPS}
    if quality is not None:
        stream_request |= {"quality_min": quality, "quality_max": quality}

    async def view(on_frame: OnFrame) -> None:
        await view_frames(http, url, on_frame, stream_request, ssl=insecure_tls())

    return await _client(stack, pair, view, operator.socket, local_view=None)


@asynccontextmanager
async def plain(
    world: World, pairs: Sequence[Pair], quality: int | None
) -> AsyncIterator[list[OperatorClient]]:
    """web_video_server's MJPEG and rosbridge itself, through one bare `ssh -R` a robot; no TLS, no guard."""
    async with AsyncExitStack() as stack:
        ports = stack.enter_context(bare_tunnels([pair.robot for pair in pairs]))
        clients = []
        for pair, own in zip(pairs, ports, strict=True):
            http = await stack.enter_async_context(http_behind(pair.operator))
            machine = pair.operator.machine
            rosbridge = await stack.enter_async_context(
                http.ws_connect(f"ws://{machine}:{own.ros}/", compress=0)
            )
            view = stream(http, f"http://{machine}:{own.video}", quality)
            local = await stack.enter_async_context(http_behind(pair.robot.uplink))
            local_view = stream(local, pair.robot.video_url, quality)
            clients.append(await _client(stack, pair, view, rosbridge, local_view))
        yield clients


def stream(http: aiohttp.ClientSession, server: str, quality: int | None) -> View:
    """Look at the camera as web_video_server gives it."""
    wanted = "" if quality is None else f"&quality={quality}"

    async def view(on_frame: OnFrame) -> None:
        await view_stream(http, f"{server}/stream?topic={CAMERA}{wanted}", on_frame)

    return view


def http_behind(uplink: Uplink) -> aiohttp.ClientSession:
    """Connections that are made in the uplink's network."""
    return aiohttp.ClientSession(connector=connector(uplink))


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
        agent_pid=pair.robot.agent_pid,
    )
