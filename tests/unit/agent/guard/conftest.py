"""What the tests of the guard share."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from controller_world import World
from fake_rosbridge import FakeRosbridge
from guard_process import GuardHere


@pytest.fixture
def world() -> World:
    return World()


@pytest.fixture
async def rosbridge() -> AsyncIterator[FakeRosbridge]:
    async with FakeRosbridge() as running:
        yield running


@pytest.fixture
async def guard(place: Path, rosbridge: FakeRosbridge) -> AsyncIterator[GuardHere]:
    """A guard at which the lease 13 is held."""
    async with GuardHere(place, rosbridge.port) as running:
        await running.grant(13)
        yield running
