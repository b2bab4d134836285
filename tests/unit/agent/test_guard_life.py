"""A guard on the bench, and when it takes over."""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest
from fake_cloud import eventually
from fake_guard import births, fake_guard_command, heard
from robotether_agent.guard_life import GuardLife
from robotether_agent.problems import GuardDown


async def test_waits_on_the_bench_and_then_tells_all(place):
    """Without orders it says nothing to anybody; who takes it over hears what it said meanwhile, once."""
    life = await GuardLife.start(fake_guard_command(place, "serves"))
    assert not life.is_fit(stopped=False)
    await eventually(lambda: life.is_fit(stopped=False), lambda: "it is ready")
    assert not life.is_fit(stopped=True)
    lines: list[Any] = []
    life.take_over(lines.append)
    assert [line["type"] for line in lines] == ["ready", "guard"]
    life.send({"type": "stop", "id": "5f0c", "by": "ben"})
    await eventually(
        lambda: any(line.get("answers") == "5f0c" for line in lines), lambda: f"{lines}"
    )
    await life.ended(0.01)
    await life.end()
    assert heard(place)[-1]["type"] == "exit"


async def test_a_dead_one_is_not_fit(place):
    """One that died on the bench is known to be dead."""
    life = await GuardLife.start(fake_guard_command(place, "serves"))
    await eventually(lambda: life.is_fit(stopped=False), lambda: "it is ready")
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    with pytest.raises(GuardDown, match="SIGKILL"):
        await life.until_end()
    assert not life.is_fit(stopped=False)
    await life.kill()
