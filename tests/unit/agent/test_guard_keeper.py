"""The keeper of the guard, with fake guard processes."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from fake_cloud import eventually
from fake_guard import births, fake_guard_command, heard
from robotether_agent.fields import FieldError
from robotether_agent.guard_keeper import (
    LAST_PAUSE_S,
    UNSENT_LIMIT,
    GuardKeeper,
    GuardView,
    pause_before,
)

WANTS = {"key": "k" * 20, "deadman_ms": 500}
URL = "ws://127.0.0.1:9090"


class Kept:
    """A keeper as a task, and what it told."""

    def __init__(self, place: Path, modes: tuple[str, ...]) -> None:
        self.views: list[GuardView] = []
        command = fake_guard_command(place, *modes)
        self.keeper = GuardKeeper(URL, command, on_change=self.views.append)
        self.task = asyncio.ensure_future(self.keeper.run())
        self._place = place

    async def ready(self, count: int = 1) -> None:
        """Wait for the guard number `count`."""

        def is_ready() -> bool:
            born = births(self._place)
            return len(born) >= count and self.keeper.view.port == born[-1]["port"]

        await eventually(is_ready, lambda: f"guard {count}: {self.keeper.view}")

    async def hears(self, *kinds: str) -> list[dict[str, Any]]:
        """Wait until the newest guard has heard these kinds, and return them, each one's last."""

        def of_the_newest() -> dict[str, dict[str, Any]]:
            lines = heard(self._place)
            start = max((at for at, line in enumerate(lines) if line["type"] == "born"), default=0)
            return {line["type"]: line for line in lines[start:]}

        await eventually(
            lambda: set(kinds) <= set(of_the_newest()), lambda: f"{kinds} in {heard(self._place)}"
        )
        return [of_the_newest()[kind] for kind in kinds]

    async def stop(self) -> None:
        self.task.cancel()
        with suppress(asyncio.CancelledError):
            await self.task


@pytest.fixture
async def keep(place: Path) -> AsyncIterator[Callable[..., Kept]]:
    """Keeps guards of the given modes, and lets them end."""
    made: list[Kept] = []

    def start(*modes: str) -> Kept:
        made.append(Kept(place, modes))
        return made[-1]

    yield start
    for kept in made:
        await kept.stop()


async def test_a_guard_is_there_without_a_session(keep, place):
    """At the start the guard knows rosbridge and no key, so that it can stop a robot and lets nobody drive."""
    kept = keep("serves")
    await kept.ready()
    config, session = await kept.hears("config", "session")
    expected = {"type": "config", "rosbridge_url": URL, "guard": {}, "direct": False}
    assert (config, session["up"]) == (expected, False)
    assert kept.keeper.view.state == "ready"


async def test_a_session_reaches_the_guard_in_order(keep, place):
    """Configuration, session, lease, stop and release arrive as the server sent them, and at once."""
    kept = keep("serves")
    await kept.ready()
    before = len(heard(place))
    kept.keeper.configured(WANTS, direct=True)
    kept.keeper.lease(13, held=True)
    kept.keeper.stop("5f0c", "ben")
    await eventually(lambda: kept.keeper.view.stopped, lambda: f"stopped: {kept.keeper.view}")
    assert kept.keeper.view.by == "ben"
    kept.keeper.release("77aa", "ann")
    await eventually(lambda: not kept.keeper.view.stopped, lambda: f"{kept.keeper.view}")
    kept.keeper.session_lost()
    await eventually(lambda: len(heard(place)) >= before + 6, lambda: f"{heard(place)}")
    # When the machine stands still for longer than a guard may be silent, another one is born behind these.
    assert heard(place)[before : before + 6] == [
        {"type": "config", "rosbridge_url": URL, "guard": WANTS, "direct": True},
        {"type": "session", "up": True},
        {"type": "lease", "fence": 13, "held": True},
        {"type": "stop", "id": "5f0c", "by": "ben"},
        {"type": "release", "id": "77aa", "by": "ann"},
        {"type": "session", "up": False},
    ]


async def test_a_killed_guard_is_back_with_all_that_it_must_know(keep, place):
    """The next one starts at once, on a port of its own, with configuration, session and lease."""
    kept = keep("serves")
    await kept.ready()
    kept.keeper.configured(WANTS, direct=False)
    kept.keeper.lease(13, held=True)
    killed_at = asyncio.get_running_loop().time()
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    await kept.ready(2)
    assert asyncio.get_running_loop().time() - killed_at < 1.0
    config, session, lease = await kept.hears("config", "session", "lease")
    assert (config["guard"], session["up"]) == (WANTS, True)
    assert (lease["fence"], lease["held"]) == (13, True)
    assert [view.port is None for view in kept.views if view.state == "down"] == [True]


async def test_one_on_the_bench_takes_over(keep, place, monkeypatch):
    """A second guard waits without orders, and has them in the moment in which the first one dies."""
    monkeypatch.setattr("robotether_agent.guard_keeper.SPARE_AFTER_S", 0.05)
    kept = keep("serves")
    await kept.ready()
    kept.keeper.configured(WANTS, direct=False)
    await eventually(lambda: len(births(place)) == 2, lambda: "one on the bench")
    spare = kept.keeper._spare
    await eventually(lambda: spare.is_fit(stopped=False), lambda: "it is ready")
    assert heard(place)[-1]["type"] == "born"
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    at_port = births(place)[1]["port"]
    await eventually(lambda: kept.keeper.view.port == at_port, lambda: f"{kept.keeper.view}", 1)
    lines = heard(place)
    born = [at for at, line in enumerate(lines) if line["type"] == "born"][1]
    assert [line["type"] for line in lines[born + 1 : born + 3]] == ["config", "session"]
    assert kept.keeper.view.state == "ready"
    await eventually(lambda: len(births(place)) == 3, lambda: "another one on the bench")
    await kept.stop()
    for born_ in births(place):
        with pytest.raises(ProcessLookupError):
            os.kill(born_["pid"], 0)


async def test_one_on_the_bench_needs_no_pause(keep, place, monkeypatch):
    """A guard that dies again and again must not leave a robot in motion to wait for the next one."""
    monkeypatch.setattr("robotether_agent.guard_keeper.SPARE_AFTER_S", 0.05)
    monkeypatch.setattr("robotether_agent.guard_keeper.pause_before", lambda _: 60.0)
    kept = keep("serves")
    await kept.ready()
    for _ in range(3):
        await eventually(lambda: kept.keeper._has_spare, lambda: "one on the bench")
        port = kept.keeper._spare._said["ready"]["port"]
        os.kill(kept.keeper._guard.pid, signal.SIGKILL)
        await eventually(
            lambda at=port: kept.keeper.view.port == at, lambda: f"{kept.keeper.view}", 1
        )


async def test_a_bench_that_knows_no_stop_is_left_there(keep, place, monkeypatch):
    """A guard that looked at the disk before somebody stopped the robot does not take over."""
    monkeypatch.setattr("robotether_agent.guard_keeper.SPARE_AFTER_S", 0.05)
    kept = keep("serves")
    await kept.ready()
    await eventually(lambda: len(births(place)) == 2, lambda: "one on the bench")
    kept.keeper.stop("5f0c", "ben")
    await eventually(lambda: kept.keeper.view.stopped, lambda: f"{kept.keeper.view}")
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    await eventually(
        lambda: kept.keeper.view.port not in {None, births(place)[0]["port"]},
        lambda: f"{kept.keeper.view}",
    )
    assert kept.keeper.view.port != births(place)[1]["port"]
    with pytest.raises(ProcessLookupError):
        os.kill(births(place)[1]["pid"], 0)


async def test_a_frozen_guard_is_replaced(keep, place):
    """A guard that hangs is killed, never left beside the next one."""
    kept = keep("serves")
    await kept.ready()
    pid = births(place)[0]["pid"]
    os.kill(pid, signal.SIGSTOP)
    await kept.ready(2)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


async def test_a_stop_that_its_guard_did_not_answer_is_told_to_the_next(keep, place):
    """A guard that dies of the stop itself leaves a stopped robot."""
    kept = keep("crashes", "serves")
    await kept.ready()
    kept.keeper.configured(WANTS, direct=False)
    kept.keeper.stop("5f0c", "ben")
    await kept.ready(2)
    await eventually(lambda: kept.keeper.view.stopped, lambda: f"{kept.keeper.view}")
    os.kill(births(place)[1]["pid"], signal.SIGKILL)
    await kept.ready(3)
    await kept.hears("config", "session")
    # The third guard may know it from its own file.
    assert stops_told(place) == ["5f0c", "5f0c", "kept"]


async def test_a_stop_that_the_disk_did_not_take_outlives_its_guard(keep, place):
    """The next guard finds no stop, and is told of it; a release is for the guard that has it."""
    kept = keep("serves")
    kept.keeper.configured(WANTS, direct=False)
    await kept.ready()
    kept.keeper.stop("5f0c", "ben")
    await eventually(lambda: kept.keeper.view.stopped, lambda: f"{kept.keeper.view}")
    with kept.keeper.following() as lines:
        os.kill(births(place)[0]["pid"], signal.SIGKILL)
        await kept.ready(2)
        # A release before the answer is refused.
        while (await asyncio.wait_for(lines.get(), 10))["answers"] != "kept":
            pass
    assert stops_told(place) == ["5f0c", "kept"]
    assert kept.keeper.view.stopped
    kept.keeper.release("77aa", "ann")
    await eventually(lambda: not kept.keeper.view.stopped, lambda: f"{kept.keeper.view}")


def stops_told(place):
    return [line["id"] for line in heard(place) if line["type"] == "stop"]


async def test_a_release_never_comes_late(keep, place):
    """What a guard that is down cannot do is not done later, when nobody expects it any more."""
    kept = keep("dies", "dies", "dies", "serves")
    kept.keeper.configured(WANTS, direct=False)
    kept.keeper.stop("5f0c", "ben")
    kept.keeper.release("77aa", "ann")
    await kept.ready(4)
    await eventually(lambda: kept.keeper.view.stopped, lambda: f"{kept.keeper.view}")
    assert not [line for line in heard(place) if line["type"] == "release"]


async def test_a_lease_of_a_lost_session_is_not_held_for_the_next_guard(keep, place):
    """A guard that starts while the session is away lets the last driver's number do nothing."""
    kept = keep("serves")
    kept.keeper.configured(WANTS, direct=False)
    kept.keeper.lease(13, held=True)
    kept.keeper.session_lost()
    await kept.ready()
    session, lease = await kept.hears("session", "lease")
    assert (session["up"], lease["fence"], lease["held"]) == (False, 13, False)


async def test_never_stops_trying(keep, place):
    """However often a guard dies, there is a next one."""
    kept = keep("dies", "dies", "rubbish", "dies", "serves")
    await kept.ready(5)
    assert kept.keeper.view.state == "ready"


def test_pauses_grow_to_a_bound():
    """The first restart is at once, later ones do not use the processor up."""
    assert [pause_before(restart) for restart in (1, 2, 3, 4)] == [0.0, 0.1, 0.2, 0.4]
    assert pause_before(1_000_000) == LAST_PAUSE_S


async def test_a_session_hears_how_it_is_and_each_answer(keep, place):
    """First the present state, then the guard's lines as they are, and that it is down."""
    kept = keep("serves")
    await kept.ready()
    with kept.keeper.following() as lines:
        first = await lines.get()
        assert (first["state"], first["stopped"], first["answers"]) == ("ready", False, None)
        kept.keeper.stop("5f0c", "ben")
        answer = await asyncio.wait_for(lines.get(), 5)
        while answer["answers"] is None:
            answer = await asyncio.wait_for(lines.get(), 5)
        assert (answer["answers"], answer["stopped"], answer["by"]) == ("5f0c", True, "ben")
        os.kill(births(place)[0]["pid"], signal.SIGKILL)
        gone = await asyncio.wait_for(lines.get(), 5)
        assert (gone["state"], gone["stopped"], gone["answers"]) == ("down", True, None)
        assert set(gone) == {"type", "state", "stopped", "by", "moving", "answers", "refused"}


async def test_a_session_that_takes_nothing_costs_no_memory(keep, place):
    """What a session does not send is bounded, and the newest line stays."""
    kept = keep("serves")
    await kept.ready()
    with kept.keeper.following() as lines:
        for number in range(UNSENT_LIMIT + 5):
            kept.keeper.stop(f"s{number}", "ben")
        last = f"s{UNSENT_LIMIT + 4}"

        def newest() -> bool:
            return any(line["answers"] == last for line in lines._queue)

        await eventually(newest, lambda: f"{lines}")
        assert lines.qsize() <= UNSENT_LIMIT


async def test_what_the_guard_would_not_take_changes_nothing(keep, place):
    """A configuration that is wrong ends the session that brought it, and the guard keeps the last good one."""
    kept = keep("serves")
    await kept.ready()
    kept.keeper.configured(WANTS, direct=False)
    with pytest.raises(FieldError, match="deadman_ms"):
        kept.keeper.configured({**WANTS, "deadman_ms": 0}, direct=True)
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    await kept.ready(2)
    assert (await kept.hears("config"))[0]["guard"] == WANTS


async def test_ends_only_after_the_guard(keep, place):
    """When the agent ends, its guard is asked to stop the robot and has ended by then."""
    kept = keep("serves")
    await kept.ready()
    await kept.stop()
    assert heard(place)[-1]["type"] == "exit"
    with pytest.raises(ProcessLookupError):
        os.kill(births(place)[0]["pid"], 0)
