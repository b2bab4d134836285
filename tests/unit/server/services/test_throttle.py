"""When the next try to log in is heard."""

from __future__ import annotations

import datetime as dt

import pytest
from robotether_server.services.throttle import (
    PER_NETWORK,
    PER_USER,
    PER_USER_AND_NETWORK,
    WINDOW,
    Failures,
    free_at,
)

START = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)


def timestamps(count: int) -> list[dt.datetime]:
    """One failure a second."""
    return [START + dt.timedelta(seconds=at) for at in range(count)]


def test_try_is_heard_below_all_limits() -> None:
    """One failure fewer than each limit, all together."""
    failures = Failures(
        timestamps(PER_USER_AND_NETWORK - 1), timestamps(PER_NETWORK - 1), timestamps(PER_USER - 1)
    )
    assert free_at(failures) is None
    assert free_at(Failures()) is None


@pytest.mark.parametrize(
    ("kind", "limit"),
    [("of_pair", PER_USER_AND_NETWORK), ("of_network", PER_NETWORK), ("of_user", PER_USER)],
)
def test_each_limit_waits_until_the_oldest_that_counts_is_forgotten(kind: str, limit: int) -> None:
    """With two failures too many the third is the one whose end leaves one fewer than the limit."""
    failures = Failures(**{kind: timestamps(limit + 2)})
    assert free_at(failures) == START + dt.timedelta(seconds=2) + WINDOW


def test_latest_of_the_ends_counts() -> None:
    """All limits must be free again."""
    failures = Failures(of_network=timestamps(PER_NETWORK), of_user=timestamps(PER_USER + 7))
    assert free_at(failures) == START + dt.timedelta(seconds=7) + WINDOW
