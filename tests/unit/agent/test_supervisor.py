"""One attempt after the other, and what of it reaches the log."""

from __future__ import annotations

import asyncio
import logging
from random import Random

import pytest
from robotether_agent.backoff import Backoff
from robotether_agent.problems import HostKeyChanged, LinkLost, NotEnrolled, Problem
from robotether_agent.supervisor import Repeats, Uptime, keep_going


class NoPause(Random):
    """Draws no pause."""

    def uniform(self, a: float, b: float) -> float:
        return 0.0


async def test_tries_again_until_nothing_helps():
    """Problems that pass are told and tried again; one that does not comes out."""
    problems: list[Problem] = [LinkLost("one"), NotEnrolled("two"), HostKeyChanged("three")]
    told: list[Problem] = []

    async def attempt(_: Uptime) -> None:
        raise problems[len(told)]

    with pytest.raises(HostKeyChanged, match="three"):
        await keep_going("session", attempt, Backoff(NoPause()), told.append)
    assert told == problems[:2]


async def test_can_be_cancelled_in_its_pause():
    reached = asyncio.Event()

    async def attempt(_: Uptime) -> None:
        raise LinkLost("x")

    def log_problem(_: Problem) -> None:
        reached.set()

    task = asyncio.ensure_future(keep_going("session", attempt, Backoff(Random(1)), log_problem))
    await asyncio.wait_for(reached.wait(), 5)
    task.cancel()
    done, _ = await asyncio.wait({task}, timeout=0.3)
    assert done


def test_repeats_are_thinned_out(caplog):
    """Of the same problem in a row the 1st, 2nd, 4th and 8th are loud; another problem is loud at once."""
    caplog.set_level(logging.INFO)
    repeats = Repeats()
    for _ in range(10):
        repeats.log_problem("session", LinkLost("lost it"), 1)
    repeats.log_problem("session", NotEnrolled("not yet"), 1)
    assert [record.levelname for record in caplog.records] == ["WARNING"] * 4 + ["INFO"]
    assert "lost it [link_lost]; next try in 1.0 s (for the 8. time)" in caplog.text


def test_two_problems_that_take_turns_are_thinned_out_too(caplog):
    """A network that comes and goes for days fills no log; after a success all is told anew."""
    repeats = Repeats()
    for _ in range(8):
        repeats.log_problem("session", LinkLost("lost it"), 1)
        repeats.log_problem("session", HostKeyChanged("changed"))
    assert len(caplog.records) == 8
    repeats.forget()
    repeats.log_problem("session", LinkLost("lost it"), 1)
    assert len(caplog.records) == 9


def test_uptime_counts_from_when_it_stood():
    now = [10.0]
    uptime = Uptime(lambda: now[0])
    assert uptime.uptime_s == 0
    now[0] = 15
    uptime.is_up()
    now[0] = 18
    uptime.is_up()
    assert uptime.uptime_s == 3
