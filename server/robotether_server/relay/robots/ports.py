"""Waits until a robot's forwarded port on sshd is free again."""

from __future__ import annotations

import asyncio

LOOK_EVERY_S = 0.02
CONNECT_TIMEOUT_S = 0.2


async def wait_released(host: str, port: int, *, within_s: float) -> bool:
    """Return True as soon as nobody accepts on `host:port`, False when `within_s` is over."""
    deadline = asyncio.get_running_loop().time() + within_s
    while await _accepts(host, port):
        if asyncio.get_running_loop().time() >= deadline:
            return False
        await asyncio.sleep(LOOK_EVERY_S)
    return True


async def _accepts(host: str, port: int) -> bool:
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            _, writer = await asyncio.open_connection(host, port)
    except OSError:  # TimeoutError is one: sshd itself is away, and no port of it is taken
        return False
    writer.close()
    return True
