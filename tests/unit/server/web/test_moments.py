"""Moments as programs read them."""

from __future__ import annotations

import datetime as dt

from robotether_server.web.moments import moment_text


def test_moment_is_rfc_3339_to_the_second() -> None:
    """In UTC; none stays none."""
    moment = dt.datetime(2026, 1, 1, 12, 3, 0, 900000, dt.UTC)
    assert moment_text(moment) == "2026-01-01T12:03:00Z"
    assert moment_text(None) is None
