"""How soon a message passes on any of the ways that are compared: after the robot's start, and after a new address.

Nobody's protocol is asked whether it is connected. An operator's program tries again and again to have the robot's
odometry on a new connection, side by side with the attempts before, as a way that leads nowhere yet may swallow an
attempt or refuse it; the first message that came because it was asked for counts.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine
from contextlib import suppress

import aiohttp

from paper.peer_echo import Echo, connected, echoing, http_of, stop
from paper.peer_transport import OBSERVE, Transport

# How often a new attempt begins, how long one lasts, and after which time it counts as never.
EVERY_S, ATTEMPT_S, GIVE_UP_S = 0.2, 1.0, 60.0
# Of an operator who gives a tunnel time to notice.
PATIENT_EVERY_S, PATIENT_GIVE_UP_S = 15.0, 180.0
HELD_HZ, POLL_EVERY_S = 20, 0.01
TELEMETRY, TELEMETRY_TYPE = "/odom", "nav_msgs/Odometry"


async def connect_s(transport: Transport) -> float | None:
    """Seconds from the start of the robot's client program to the first message from it; None: never."""
    since = time.monotonic()
    await asyncio.to_thread(transport.connect)
    return await first_message_s(transport, since)


async def first_message_s(
    transport: Transport, since: float, every_s: float = EVERY_S, give_up_s: float = GIVE_UP_S
) -> float | None:
    """Seconds from `since` until a message has come on a new connection; one is tried each `every_s`."""
    first: asyncio.Future[float] = asyncio.get_running_loop().create_future()
    attempts = []
    try:
        while time.monotonic() < since + give_up_s:
            attempts.append(asyncio.ensure_future(_attempt(transport, first)))
            await asyncio.wait([first], timeout=every_s)
            if first.done():
                return first.result() - since
            transport.check()
        return None
    finally:
        for attempt in attempts:
            await stop(attempt)


async def _attempt(transport: Transport, first: asyncio.Future[float]) -> None:
    """Try once, and tell `first` the moment of the message."""
    with suppress(aiohttp.ClientError, OSError, TimeoutError, TypeError):
        async with asyncio.timeout(ATTEMPT_S), http_of(transport) as http:
            url = await asyncio.to_thread(transport.ros_url, OBSERVE)
            async with connected(http, url) as socket:
                wanted = {"op": "subscribe", "topic": TELEMETRY, "type": TELEMETRY_TYPE}
                await socket.send_json(wanted)
                while '"publish"' not in await socket.receive_str():
                    pass
                if not first.done():
                    first.set_result(time.monotonic())


async def recover_s(transport: Transport, after_s: float) -> float | None:
    """Seconds from the robot's new address until a message passes, on the connection that was there or on a new one.

    The connection has stood for `after_s`, with messages both ways all the time; None: never.
    """
    async with echoing(transport) as held:
        # What a robot says by itself shows some ways where it is now.
        await held.send_topic("subscribe", TELEMETRY, TELEMETRY_TYPE)
        holding = asyncio.ensure_future(_hold(held))
        try:
            await asyncio.wait([holding], timeout=after_s)
            if holding.done():
                holding.result()
            await asyncio.to_thread(transport.readdress)
            since = time.monotonic()
            return await _first(
                _held_answer_s(held, holding, since), first_message_s(transport, since)
            )
        finally:
            await stop(holding)


async def recover_patiently_s(transport: Transport) -> float | None:
    """As recover_s, with an operator whose connections are closed, and who tries each PATIENT_EVERY_S only."""
    await asyncio.to_thread(transport.readdress)
    since = time.monotonic()
    await asyncio.sleep(PATIENT_EVERY_S)
    return await first_message_s(transport, since, PATIENT_EVERY_S, PATIENT_GIVE_UP_S)


async def _hold(held: Echo) -> None:
    """Send and take messages until the connection ends."""
    taking = asyncio.ensure_future(_receive(held))
    try:
        number = 0
        while not taking.done():
            await held.send(number)
            number += 1
            await asyncio.wait([taking], timeout=1 / HELD_HZ)
        taking.result()
    finally:
        await stop(taking)


async def _receive(held: Echo) -> None:
    while True:
        await held.receive()


async def _held_answer_s(held: Echo, holding: asyncio.Future[None], since: float) -> float | None:
    """Seconds until a message that was sent after `since` has come back; None when the connection ended, or never."""
    while held.answered_of < since:
        if holding.done() or time.monotonic() > since + GIVE_UP_S:
            return None
        await asyncio.sleep(POLL_EVERY_S)
    return time.monotonic() - since


async def _first(*transports: Coroutine[None, None, float | None]) -> float | None:
    """What the first of these gives that gives something; the others are ended."""
    tasks = [asyncio.ensure_future(transport) for transport in transports]
    try:
        for done in asyncio.as_completed(tasks):
            if (took_s := await done) is not None:
                return took_s
        return None
    finally:
        for task in tasks:
            await stop(task)
