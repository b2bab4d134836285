"""A guard on the bench, and when it takes over."""

from __future__ import annotations

import os
import signal

import pytest
from fake_cloud import eventually
from fake_guard import births, fake_guard_command
from robotether_agent.guard_life import GuardLife
from robotether_agent.problems import GuardDown


async def test_a_dead_one_is_not_fit(place):
    life = await GuardLife.start(fake_guard_command(place, "serves"))
    await eventually(lambda: life.is_fit(stopped=False), lambda: "it is ready")
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    with pytest.raises(GuardDown, match="SIGKILL"):
        await life.until_end()
    assert not life.is_fit(stopped=False)
    await life.kill()
