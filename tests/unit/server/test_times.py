"""Times and days as people write them."""

import datetime as dt

import pytest
from robotether_server import times
from robotether_server.problems import FieldInvalidError

NOON = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)


@pytest.mark.parametrize(
    "text",
    ["2026-01-31 12:00z", "2026-01-31T14:00:00.000000999+02:00", "2026-01-31T14:00:00 02:00"],
)
def test_moment_is_taken_with_its_offset(text):
    found = times.timestamp("until", text)
    assert (found, found.utcoffset()) == (NOON, dt.timedelta())


@pytest.mark.parametrize(
    "text",
    [
        "2026-01-31T12:00:00",
        "2026-01-31 12:00",
        "2026-02-30T12:00:00Z",
        "0001-01-01T00:00:00+02:00",
        "2026-W05-6T12:00:00Z",
        "٢٠٢٦-01-31T12:00:00Z",
    ],
)
def test_what_is_no_moment_is_refused_with_its_field(text):
    with pytest.raises(FieldInvalidError, match=r"cannot use until: .* 2026-01-31T12:00:00Z"):
        times.timestamp("until", text)


def test_a_duration_over_a_clock_set_back_is_unknown():
    assert times.duration_words(-3600) == "unknown"
