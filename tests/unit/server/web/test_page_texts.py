"""How values are written on pages."""

import datetime as dt

import pytest
from robotether_server.db.robots import RobotRow
from robotether_server.web.page_texts import (
    drive_end,
    key_groups,
    refusal,
    session_end,
    size_words,
    state_words,
    timestamp_words,
)


def test_moments_are_in_utc():
    """Whatever zone they come in."""
    noon = dt.datetime(2026, 1, 1, 12, 3, 59, tzinfo=dt.timezone(dt.timedelta(hours=2)))
    assert timestamp_words(noon) == "2026-01-01 10:03:59 UTC"


def test_groups_of_a_key_are_the_whole_key():
    """Nothing is added between them, so what is copied is the fingerprint."""
    fingerprint = "SHA256:" + "abcdefghij" * 4 + "xyz"
    groups = key_groups(fingerprint)
    assert groups[:3] == ["SHA256:", "abcd", "efgh"]
    assert "".join(groups) == fingerprint


@pytest.mark.parametrize(
    ("state", "fingerprint", "words"),
    [
        ("pending", None, "Announced"),
        ("pending", "SHA256:x", "Awaiting approval"),
        ("active", "SHA256:x", "Active"),
        ("disabled", None, "Disabled"),
    ],
)
def test_a_state_in_words(state, fingerprint, words):
    """A robot that has not joined is told from one that waits."""
    robot = RobotRow(
        1, "02:00:00:00:00:01", "sim1", state, 1, 2, fingerprint, {}
    )  # a state of the list above
    assert state_words(robot) == words


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (0, "0 B"),
        (999, "999 B"),
        (1000, "1.0 kB"),
        (999_949, "999.9 kB"),
        (999_950, "1.0 MB"),
        (181_234_567, "181.2 MB"),
        (10**13, "10000.0 GB"),
    ],
)
def test_sizes_have_the_unit_that_makes_them_short(count, words):
    """A thousand of one is one of the next; after the last one it grows."""
    assert size_words(count) == words


def test_unknown_code_is_shown_as_it_is():
    """A page tells what it can."""
    assert (refusal("guard_old"), refusal("eaten")) == ("too old at the robot", "eaten")
    assert (drive_end("lease_lost"), drive_end("eaten")) == ("somebody else got control", "eaten")
    assert (session_end("superseded"), session_end("eaten")) == (
        "a newer session took over",
        "eaten",
    )
