"""Fixtures that image and end-to-end tests share: one running stack for the whole run."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from stack import ROOT, Stack


@pytest.fixture(scope="session")
def stack() -> Iterator[Stack]:
    """The whole stack with three simulated robots, removed at the end."""
    running = Stack(ROOT / "tests" / "artifacts" / "stack")
    try:
        running.up()
        yield running
    finally:
        running.down()
