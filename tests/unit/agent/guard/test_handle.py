"""A guard as a hot spare, and when it takes over."""

from __future__ import annotations

import os
import signal

import pytest
from fake_cloud import eventually
from fake_guard import births, fake_guard_command
from robotether_agent.guard.handle import GuardHandle
from robotether_agent.problems import GuardDown


async def test_a_dead_one_is_not_fit(place):
    handle = await GuardHandle.start(fake_guard_command(place, "serves"))
    await eventually(lambda: handle.is_fit(stopped=False), lambda: "it is ready")
    os.kill(births(place)[0]["pid"], signal.SIGKILL)
    with pytest.raises(GuardDown, match="SIGKILL"):
        await handle.until_end()
    assert not handle.is_fit(stopped=False)
    await handle.kill()
