"""When the next try to log in is heard."""

from __future__ import annotations

import datetime as dt

import pytest
from robotether_server.web.throttle import PER_ADDRESS, PER_USER_AND_ADDRESS, WINDOW, free_at

START = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)


def failures(*names: str) -> list[tuple[str, dt.datetime]]:
    """One failure a second."""
    return [(name, START + dt.timedelta(seconds=at)) for at, name in enumerate(names)]


@pytest.mark.parametrize(
    "names",
    [
        [],
        ["ann"] * (PER_USER_AND_ADDRESS - 1),
        ["bob"] * 10,
        [f"u{n}" for n in range(PER_ADDRESS - 1)],
    ],
)
def test_try_is_heard_below_both_limits(names: list[str]) -> None:
    """Another user's failures count for the address alone."""
    assert free_at(failures(*names), "ann") is None


def test_user_waits_until_the_oldest_that_counts_is_forgotten() -> None:
    """Of seven failures the third is the one whose end leaves four."""
    assert free_at(failures(*["ann"] * 7), "ann") == START + dt.timedelta(seconds=2) + WINDOW


def test_address_waits_whatever_the_name() -> None:
    """Many names from one address are one attacker."""
    names = [f"u{number}" for number in range(PER_ADDRESS)]
    assert free_at(failures(*names), "ann") == START + WINDOW


def test_later_of_both_ends_counts() -> None:
    """Both limits must be free again."""
    names = [f"u{number}" for number in range(PER_ADDRESS)] + ["ann"] * PER_USER_AND_ADDRESS
    end = free_at(failures(*names), "ann")
    assert end == START + dt.timedelta(seconds=PER_ADDRESS) + WINDOW
