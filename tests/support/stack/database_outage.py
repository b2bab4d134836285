"""A running stack without its database for a while, for tests of what goes on meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from stack import Stack


@contextmanager
def database_away(stack: Stack) -> Iterator[None]:
    """Stop the database inside the block; after it the next test finds it, and a relay that reads it, as ever."""
    mysql = stack.container("mysql")
    mysql.stop(timeout=20)
    try:
        yield
    finally:
        mysql.start()
        stack.wait_healthy("mysql")
        # A relay that is still trying to reach the one that is gone hears of changes seconds late.
        stack.wait_for_changes("sim1")
