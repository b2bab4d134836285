"""Parses times and days as people and programs write them, every refusal with its field; and pauses of retries.

Used by web, relay and the command line. Pure, except for the clock in `utc_now`.
"""

import datetime as dt
import re
from collections.abc import Iterator
from typing import overload

from robotether_server.problems import FieldInvalidError

MAX_TEXT_LENGTH = 40
MUST_BE = "a timestamp with its offset, such as 2026-01-31T12:00:00Z"
# Maximum of TICKET_TTL_S, and maximum time by which the clock of another machine that signs tickets may be ahead.
MAX_TICKET_TTL_S = 300
MAX_TICKET_AHEAD_S = 2
MAX_WAIT = dt.timedelta(days=3660)
# Bounds in seconds of all histograms of times, so that they compare.
BOUNDS_S = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0)

# RFC 3339, which always has an offset; Python's own reader takes much more.
_TIMESTAMP = re.compile(
    r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d(:\d\d(\.\d{1,9})?)?([Zz]|[+-]\d\d:\d\d)", re.ASCII
)
_DAY = re.compile(r"\d{4}-\d\d-\d\d", re.ASCII)
_LAST_OF_DAY = dt.time(23, 59, 59, tzinfo=dt.UTC)
_FIRST_OF_DAY = dt.time(0, 0, 0, tzinfo=dt.UTC)


def utc_now() -> dt.datetime:
    """Return the time for people; durations are measured with a monotonic clock."""
    return dt.datetime.now(dt.UTC)


@overload
def rfc3339(timestamp: dt.datetime) -> str: ...


@overload
def rfc3339(timestamp: dt.datetime | None) -> str | None: ...


def rfc3339(timestamp: dt.datetime | None) -> str | None:
    """Write a time as the API does: UTC, whole seconds, such as 2026-01-31T12:00:00Z; None stays None."""
    if timestamp is None:
        return None
    return timestamp.astimezone(dt.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def timestamp(field: str, text: str) -> dt.datetime:
    """Parse an RFC 3339 time, such as 2026-01-31T12:00:00Z, into UTC; raise FieldInvalidError."""
    if text[-6:-5] == " ":
        # In a query a + that is not written as %2B is a space.
        text = f"{text[:-6]}+{text[-5:]}"
    try:
        if _TIMESTAMP.fullmatch(text):
            return dt.datetime.fromisoformat(text.upper()).astimezone(dt.UTC)
    except (ValueError, OverflowError):
        pass
    raise FieldInvalidError(f"cannot use {field}: it must be {MUST_BE}", field)


def day_or_timestamp(field: str, text: str, *, is_end: bool) -> dt.datetime:
    """Parse a time as `timestamp` does, or a day in UTC such as 2026-01-31: its start, or its last second."""
    try:
        if _DAY.fullmatch(text):
            clock = _LAST_OF_DAY if is_end else _FIRST_OF_DAY
            return dt.datetime.combine(dt.date.fromisoformat(text), clock)
        return timestamp(field, text)
    except (ValueError, FieldInvalidError) as error:
        raise FieldInvalidError(
            f"cannot use {field}: it must be a day in UTC, such as 2026-01-31, or {MUST_BE}",
            field,
        ) from error


def check_end(ends_at: dt.datetime, now: dt.datetime) -> None:
    """Raise FieldInvalidError for a grant's end that has passed, or is so far away that it must be a mistake."""
    wait = ends_at - now
    if wait <= dt.timedelta():
        raise FieldInvalidError(
            "cannot give a grant: its end has passed; give a time in the future", "ends_at"
        )
    if wait > MAX_WAIT:
        raise FieldInvalidError(
            "cannot give a grant: its end is over ten years away; leave it out for none", "ends_at"
        )


def duration_words(seconds: float) -> str:
    """Return a duration as people read it: 8 s, 1 min 35 s, 2 h 5 min; unknown where a clock was set back."""
    if seconds < 0:
        return "unknown"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def delays(first_s: float = 0.5, max_s: float = 5.0) -> Iterator[float]:
    """Yield seconds to wait before the second, third, ... try."""
    delay = first_s
    while True:
        yield delay
        delay = min(delay * 2, max_s)
