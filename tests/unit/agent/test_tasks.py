"""Running coroutines side by side."""

import asyncio

import pytest
from robotether_agent.tasks import first_of, within


async def test_first_of_prefers_the_one_named_first():
    """Of two that fail in one moment the first named counts: a goodbye before a broken pipe."""

    async def failing(text):
        raise ValueError(text)

    with pytest.raises(ValueError, match="goodbye"):
        await first_of(failing("goodbye"), failing("broken pipe"))


async def test_first_of_may_end_the_others_in_order():
    """What is named first has ended before the next is told to: the robot stands before its tunnels close."""
    ended = []

    async def lasting(name, pause_s):
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(pause_s)
            ended.append(name)

    both = first_of(lasting("first", 0.05), lasting("second", 0), in_order=True)
    running = asyncio.ensure_future(both)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert ended == ["first", "second"]


async def cancel_as_it_ends(work, ends):
    """Cancel `work` in the turn in which what it waits for has its result."""
    task = asyncio.ensure_future(work)
    for _ in range(3):
        await asyncio.sleep(0)
    ends.set()
    # One turn lets the inner work end; its result and the cancellation then arrive together.
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait({task}, timeout=1)
    assert task.cancelled()


async def test_within_loses_no_result_to_a_cancellation():
    """What was opened in the very moment of a cancellation reaches the one who closes it."""
    opened, log = asyncio.Event(), []

    async def opening():
        await opened.wait()
        return "a socket"

    async def using():
        socket = await within(5, opening())
        try:
            log.append(f"has {socket}")
            await asyncio.sleep(0)
            log.append("was not cancelled")
        finally:
            log.append("closed it")

    await cancel_as_it_ends(using(), opened)
    assert log == ["has a socket", "closed it"]
