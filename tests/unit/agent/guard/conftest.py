"""What the tests of the guard share."""

import pytest
from controller_world import World
from fake_rosbridge import FakeRosbridge
from guard_process import GuardHere


@pytest.fixture
def world():
    return World()


@pytest.fixture
async def rosbridge():
    async with FakeRosbridge() as running:
        yield running


@pytest.fixture
async def guard(place, rosbridge):
    """A guard at which the lease 13 is held."""
    async with GuardHere(place, rosbridge.port) as running:
        await running.grant(13)
        yield running
