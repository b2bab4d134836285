"""What the tests of the helm share."""

from __future__ import annotations

import pytest
from helm_world import World


@pytest.fixture
def world() -> World:
    return World()
