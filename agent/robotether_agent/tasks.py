"""Runs coroutines side by side so that none outlives the others; used wherever the agent has tasks."""

from __future__ import annotations

import asyncio
import logging
import socket
import sys
from collections.abc import Coroutine, Sequence
from typing import Any, TypeVar

T = TypeVar("T")

log = logging.getLogger(__name__)


async def first_of(*work: Coroutine[Any, Any, T], in_order: bool = False) -> T:
    """Run all of `work` until one ends, end the others, and return or raise what the ended one did.

    If several end at the same time, the one named first counts. With `in_order` each has ended before the
    next one named is cancelled.
    """
    tasks = [asyncio.ensure_future(coroutine) for coroutine in work]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        ended = next(task for task in tasks if task.done())
    finally:
        for group in [[task] for task in tasks] if in_order else [tasks]:
            await _end(group)
    return ended.result()


async def within(timeout_s: float, work: Coroutine[Any, Any, T]) -> T:
    """Return what `work` returns, or raise asyncio.TimeoutError after `timeout_s`.

    In place of asyncio.wait_for, which before Python 3.12 swallows a cancellation that comes just when
    the work ends (python/cpython#86296): a task that reads line after line then never ends. Nor is the result
    lost then, since only the caller can close it: it is returned, and the caller's next await is cancelled.
    """
    task = asyncio.ensure_future(work)
    try:
        await asyncio.wait({task}, timeout=timeout_s)
        await _cancelled(task)
    except asyncio.CancelledError:
        await _cancelled(task)
        if task.cancelled() or task.exception() is not None:
            raise
        _cancel_at_next_await()
    if task.cancelled():
        raise asyncio.TimeoutError
    return task.result()


async def readable(connection: socket.socket) -> None:
    """Wait until there is something to read on `connection`, or its end."""
    loop = asyncio.get_running_loop()
    event = asyncio.Event()
    loop.add_reader(connection, event.set)
    try:
        await event.wait()
    finally:
        loop.remove_reader(connection)


async def _cancelled(task: asyncio.Future[T]) -> None:
    if not task.done():
        task.cancel()
        await asyncio.wait({task})


def _cancel_at_next_await() -> None:
    caller = asyncio.current_task()
    if caller is not None:
        if sys.version_info >= (3, 11):
            # One request to cancel stays one: asyncio.timeout counts them.
            caller.uncancel()
        caller.cancel()


async def _end(tasks: Sequence[asyncio.Future[T]]) -> None:
    for task in tasks:
        task.cancel()
    for result in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(result, BaseException) and not isinstance(result, asyncio.CancelledError):
            log.debug("a task ended with %r", result)
