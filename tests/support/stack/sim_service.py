"""Calls a service of a simulated robot on its own rosbridge and not through the server."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import aiohttp
from docker_engine import address_of
from sim_watch import Containers

ANSWER_S = 10


def call_sim(stack: Containers, sim: str, service: str, **args: Any) -> dict[str, Any]:
    """Call a service and return its values; fail when the simulator says that it failed."""
    url = f"ws://{address_of(stack.container(sim))}:9090/"
    # A thread of its own, as Playwright keeps a loop running in this one.
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(asyncio.run, _call(url, service, args)).result()
    assert answer["result"], f"{service} of {sim} says {answer['values']}"
    values: dict[str, Any] = answer["values"]
    return values


@contextmanager
def frozen_cameras(stack: Containers, sim: str) -> Iterator[None]:
    """While this lasts no camera of the simulator gives a new picture."""
    call_sim(stack, sim, "/sim/freeze_camera", data=True)
    try:
        yield
    finally:
        call_sim(stack, sim, "/sim/freeze_camera", data=False)


async def _call(url: str, service: str, args: dict[str, Any]) -> dict[str, Any]:
    async with (
        asyncio.timeout(ANSWER_S),
        aiohttp.ClientSession() as http,
        http.ws_connect(url) as socket,
    ):
        await socket.send_json({"op": "call_service", "id": "1", "service": service, "args": args})
        async for frame in socket:
            message: dict[str, Any] = json.loads(frame.data)
            if message.get("op") == "service_response":
                return message
    raise AssertionError(f"{url} closed before it answered {service}")
