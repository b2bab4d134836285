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
from picture_viewers import Taker, look_at_frames, look_at_stream

from paper.operator import Operator, connector
from paper.operators_bare import bare_tunnels
from paper.operators_plan import FPS
from paper.operators_run import Look, Seat
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
Way = Callable[[World, Sequence[Pair], int | None], AbstractAsyncContextManager[list[Seat]]]


@asynccontextmanager
async def ours(
    world: World, pairs: Sequence[Pair], quality: int | None
) -> AsyncIterator[list[Seat]]:
    """Video by the frames protocol and commands by a drive session, both through the stack's door."""
    robots = [pair.robot for pair in pairs]
    wait_all_online(robots, ONLINE_WITHIN_S)
    async with AsyncExitStack() as stack:
        yield [await _our_seat(stack, world, pair, quality) for pair in pairs]


async def _our_seat(stack: AsyncExitStack, world: World, pair: Pair, quality: int | None) -> Seat:
    http = await stack.enter_async_context(http_behind(pair.operator))
    operator = Operator(http, world, pair.operator, pair.robot.name)
    await stack.enter_async_context(operator)
    ticket = world.ticket(pair.robot.name, "observe")
    url = (
        f"https://{world.door}/robots/{pair.robot.name}/video/frames?topic={CAMERA}&ticket={ticket}"
    )
    want: dict[str, int] = {"fps": FPS}
    if quality is not None:
        want |= {"quality_min": quality, "quality_max": quality}

    async def look(take: Taker) -> None:
        await look_at_frames(http, url, take, want, ssl=insecure_tls())

    return await _seat(stack, pair, look, operator.socket, onlooker=None)


@asynccontextmanager
async def plain(
    world: World, pairs: Sequence[Pair], quality: int | None
) -> AsyncIterator[list[Seat]]:
    """web_video_server's MJPEG and rosbridge itself, through one bare `ssh -R` a robot; no TLS, no guard."""
    async with AsyncExitStack() as stack:
        ports = stack.enter_context(bare_tunnels([pair.robot for pair in pairs]))
        seats = []
        for pair, own in zip(pairs, ports, strict=True):
            http = await stack.enter_async_context(http_behind(pair.operator))
            machine = pair.operator.machine
            rosbridge = await stack.enter_async_context(
                http.ws_connect(f"ws://{machine}:{own.ros}/", compress=0)
            )
            look = stream(http, f"http://{machine}:{own.video}", quality)
            local = await stack.enter_async_context(http_behind(pair.robot.uplink))
            onlooker = stream(local, pair.robot.video_url, quality)
            seats.append(await _seat(stack, pair, look, rosbridge, onlooker))
        yield seats


def stream(http: aiohttp.ClientSession, server: str, quality: int | None) -> Look:
    """Look at the camera as web_video_server gives it."""
    wanted = "" if quality is None else f"&quality={quality}"

    async def look(take: Taker) -> None:
        await look_at_stream(http, f"{server}/stream?topic={CAMERA}{wanted}", take)

    return look


def http_behind(uplink: Uplink) -> aiohttp.ClientSession:
    """Connections that are made in the uplink's network."""
    return aiohttp.ClientSession(connector=connector(uplink))


async def _seat(
    stack: AsyncExitStack,
    pair: Pair,
    look: Look,
    rosbridge: aiohttp.ClientWebSocketResponse,
    onlooker: Look | None,
) -> Seat:
    local = await stack.enter_async_context(http_behind(pair.robot.uplink))
    witness = await stack.enter_async_context(
        local.ws_connect(pair.robot.ros_url, compress=0, max_msg_size=0)
    )
    return Seat(
        robot=pair.robot.name,
        look=look,
        rosbridge=rosbridge,
        witness=witness,
        onlooker=onlooker,
        simulator_pid=pair.robot.ros_pid,
        agent_pid=pair.robot.agent_pid,
    )
