"""What the tests of the drive controller share."""

from __future__ import annotations

import pytest
from controller_world import World


@pytest.fixture
def world() -> World:
    return World()
