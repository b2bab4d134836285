"""Fixtures of the simulated robot's tests."""

from collections.abc import AsyncIterator

import pytest
from sim_client import SETTINGS
from sim_robot.simulator import Simulator


@pytest.fixture
async def simulator() -> AsyncIterator[Simulator]:
    """A whole simulated robot on free ports."""
    async with Simulator(SETTINGS) as running:
        yield running
