"""Ways that are tried side by side: the first that works wins, nothing is left behind."""

from __future__ import annotations

import asyncio

import pytest
from fake_cloud import eventually
from robotether_agent.net.happy_eyeballs import HappyEyeballs, after, combined_problem
from robotether_agent.problems import NoAnswerError, ServerBusyError, ServerUnreachableError


class Attempts:
    def __init__(self) -> None:
        self.started: list[str] = []
        self.ended: list[str] = []
        self.dropped: list[str] = []

    def that(self, name: str, outcome=None, *, when: asyncio.Event | None = None):
        async def attempt() -> str:
            self.started.append(name)
            try:
                await (when or asyncio.Event()).wait() if when or outcome is None else None
                if isinstance(outcome, Exception):
                    raise outcome
                return name
            finally:
                self.ended.append(name)

        return attempt


def never():
    return asyncio.Event().wait()


@pytest.fixture
def attempts() -> Attempts:
    return Attempts()


async def test_two_that_work_in_the_same_moment(attempts):
    now = asyncio.Event()
    ways = [attempts.that(name, when=now) for name in ("one", "other")]
    race = HappyEyeballs(ways, pause=after(0), drop=attempts.dropped.append)
    winner = asyncio.ensure_future(race.winner())
    await eventually(lambda: len(attempts.started) == 2, lambda: "both have started")
    now.set()
    assert {await asyncio.wait_for(winner, 5), *attempts.dropped} == {"one", "other"}


async def test_a_defect_is_not_hidden(attempts):
    ways = [attempts.that("broken", ValueError("a defect")), attempts.that("second", "works")]
    with pytest.raises(ValueError, match="a defect"):
        await HappyEyeballs(ways, pause=never, drop=attempts.dropped.append).winner()


@pytest.mark.parametrize("turns", range(12))
async def test_cancelled_at_any_moment_nothing_that_came_is_lost(attempts, turns):
    ways = [attempts.that("silent"), attempts.that("works", "works")]
    race = HappyEyeballs(ways, pause=after(0), drop=attempts.dropped.append)
    racing = asyncio.ensure_future(race.winner())
    for _ in range(turns):
        await asyncio.sleep(0)
    racing.cancel()
    [won] = await asyncio.gather(racing, return_exceptions=True)
    await asyncio.sleep(0)
    came = ["works"] if "works" in attempts.ended else []
    assert attempts.dropped == ([] if won == "works" else came)


async def test_a_busy_server_ends_the_attempts(attempts):
    """Its other ports are not asked: they lead to the same server."""
    ways = [attempts.that("busy", ServerBusyError("full")), attempts.that("second", "works")]
    with pytest.raises(ServerBusyError, match="full"):
        await HappyEyeballs(ways, pause=after(10), drop=attempts.dropped.append).winner()
    assert attempts.started == ["busy"]


@pytest.mark.parametrize(
    ("problems", "kind", "words"),
    [
        ([], NoAnswerError, "nothing answers"),
        ([NoAnswerError("a"), NoAnswerError("a"), NoAnswerError("b")], NoAnswerError, "a; b"),
        ([NoAnswerError("a"), ServerUnreachableError("b")], ServerUnreachableError, "b"),
        (
            [NoAnswerError("a"), ServerUnreachableError("b"), ServerBusyError("c")],
            ServerBusyError,
            "c",
        ),
    ],
)
def test_of_several_problems_the_servers_own_word_counts(problems, kind, words):
    """A refusal counts more than the silence beside it, since it waits longer; that it is busy explains most."""
    found = combined_problem(problems)
    assert (type(found), found.message.removeprefix("cannot connect: ")) == (kind, words)
