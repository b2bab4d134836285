"""Times and days as people write them."""

import datetime as dt

import pytest
from robotether_server import times
from robotether_server.problems import FieldInvalidError

NOON = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)


@pytest.mark.parametrize("text", ["2026-01-31 12:00z", "2026-01-31T14:00:00.000000+02:00"])
def test_moment_is_taken_with_its_offset(text):
    found = times.timestamp("until", text)
    assert (found, found.utcoffset()) == (NOON, dt.timedelta())


@pytest.mark.parametrize(
    "text",
    [
        "2026-01-31T12:00:00",
        "2026-02-30T12:00:00Z",
        "0001-01-01T00:00:00+02:00",
        "2026-W05-6T12:00:00Z",
        "٢٠٢٦-01-31T12:00:00Z",
    ],
)
def test_what_is_no_moment_is_refused_with_its_field(text):
    with pytest.raises(FieldInvalidError, match=r"cannot use until: .* 2026-01-31T12:00:00Z"):
        times.timestamp("until", text)


def test_day_begins_and_ends_in_utc():
    first = times.day_or_timestamp("d", "2026-01-31", is_end=False)
    last = times.day_or_timestamp("d", "2026-01-31", is_end=True)
    assert (first, last) == (NOON.replace(hour=0), NOON.replace(hour=23, minute=59, second=59))
    assert times.day_or_timestamp("d", "2026-01-31T12:00:00Z", is_end=True) == NOON


@pytest.mark.parametrize("text", ["2026-02-30", "2026-1-31"])
def test_what_is_no_day_is_refused(text):
    with pytest.raises(FieldInvalidError, match="a day in UTC, such as 2026-01-31, or a timestamp"):
        times.day_or_timestamp("Until", text, is_end=True)


@pytest.mark.parametrize(
    ("wait", "why"),
    [(dt.timedelta(seconds=-1), "has passed"), (dt.timedelta(days=3661), "ten years")],
)
def test_end_must_be_to_come_and_not_too_far(wait, why):
    now = dt.datetime.now(dt.UTC)
    times.check_end("ends_at", now + dt.timedelta(minutes=1), now)
    times.check_end("ends_at", now + dt.timedelta(days=3659), now)
    with pytest.raises(FieldInvalidError, match=f"cannot use ends_at: .*{why}"):
        times.check_end("ends_at", now + wait, now)
