"""Ends tasks and waits for events: used wherever the server has tasks beside another."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Coroutine
from contextlib import suppress
from typing import Any


async def end_tasks(tasks: Collection[asyncio.Task[Any]]) -> None:
    """End them, and return when they have ended."""
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def run_until_first(*parts: Coroutine[Any, Any, Any]) -> None:
    """Run them beside each other until one has ended, or failed; then end the others."""
    tasks = [asyncio.ensure_future(part) for part in parts]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        await end_tasks(tasks)


async def wait_for_event(event: asyncio.Event, within_s: float | None) -> None:
    """Wait until the event is set, at most for this time, and clear it."""
    with suppress(TimeoutError):
        async with asyncio.timeout(within_s):
            await event.wait()
    event.clear()
