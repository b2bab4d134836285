"""The loop keeps its rate."""

import asyncio
import contextlib
import logging
import time

import pytest
from sim_client import until
from sim_robot.simulator import FixedRate
from stopwatch import Stopwatch


async def run_until(rate: FixedRate, calls: int) -> Stopwatch:
    """Run until that many calls were made; how long it took."""
    task = asyncio.create_task(rate.run())
    with Stopwatch() as stopwatch:
        await until(f"{calls} calls", lambda: rate.calls >= calls)
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
    return stopwatch


async def test_rate_does_not_drift_with_work() -> None:
    """100 calls of 2 ms work every 5 ms take 0.5 s, not 0.7 s."""
    rate = FixedRate(0.005, lambda: time.sleep(0.002))
    took = await run_until(rate, 100)
    assert took.clock_s >= 0.49
    assert took.s < 0.62


async def test_short_delay_is_made_up() -> None:
    """After one call that takes 0.1 s the missed ones follow, and none is skipped."""
    pauses = [0.1]
    rate = FixedRate(0.005, lambda: time.sleep(pauses.pop() if pauses else 0))
    took = await run_until(rate, 60)
    # A pause of the machine makes the delay a long one.
    assert rate.skipped == 0 or took.clock_s - took.s > 0.1
    assert took.s < 0.42


async def test_long_delay_is_skipped_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    """After a stall of 0.5 s the loop does not race through the missed calls, and says so."""
    pauses = [0.5]
    rate = FixedRate(0.005, lambda: time.sleep(pauses.pop() if pauses else 0))
    with caplog.at_level(logging.WARNING):
        took = await run_until(rate, 10)
    # No more than there was time for, 110 on a machine that does not pause by itself.
    assert 90 <= rate.skipped <= took.clock_s / 0.005
    assert "cannot hold 200.0 Hz" in caplog.text
