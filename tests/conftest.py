"""Fixtures that image and end-to-end tests share: one running stack for the whole run."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from stack import Stack


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """The whole stack with three simulated robots, removed at the end."""
    running = Stack(tmp_path_factory.mktemp("stack"))
    try:
        running.up()
        yield running
    finally:
        running.down()
