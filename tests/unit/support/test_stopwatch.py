"""The stopwatch counts what holds code up, and no pause of the whole process."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from stopwatch import Stopwatch

HELD_S = 0.3
SUPPORT = Path(__file__).parents[2] / "support"
PROGRAM = """
import sys
from stopwatch import Stopwatch
with Stopwatch() as stopwatch:
    print("began", flush=True)
    sys.stdin.readline()
print(stopwatch.s, stopwatch.clock_s)
"""


def work() -> None:
    """Compute, without a call that lets other threads run."""
    end = time.monotonic() + HELD_S
    while time.monotonic() < end:
        pass


@pytest.mark.alone  # beside other tests most ticks of a sleep may come late
async def test_a_loop_that_is_held_up_counts() -> None:
    """By a call that blocks as by work, and whoever reads it last."""
    for hold_up in (lambda: time.sleep(HELD_S), work):
        with Stopwatch() as stopwatch:
            await asyncio.sleep(0)
            hold_up()
            assert stopwatch.s > HELD_S / 2
        lasted_s = stopwatch.s
        await asyncio.sleep(0.05)
        assert stopwatch.s == lasted_s


def test_work_that_lets_no_other_thread_run_counts() -> None:
    """The thread of the stopwatch does not see it; the processor time tells it from a pause."""
    with Stopwatch() as stopwatch:
        before_s = time.thread_time()
        sum(range(30_000_000))
        worked_s = time.thread_time() - before_s
    assert worked_s > 0.1
    assert stopwatch.s > 0.8 * worked_s


def test_a_pause_of_the_process_does_not_count() -> None:
    """As a machine makes it that gives its processors to others."""
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        env=os.environ | {"PYTHONPATH": str(SUPPORT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as program:
        assert program.stdin is not None
        assert program.stdout is not None
        assert program.stdout.readline() == "began\n"
        program.send_signal(signal.SIGSTOP)
        time.sleep(1)
        program.send_signal(signal.SIGCONT)
        told, _ = program.communicate("end\n", timeout=30)
    counted_s, lasted_s = map(float, told.split())
    assert lasted_s > 1
    assert counted_s < lasted_s - 0.9
