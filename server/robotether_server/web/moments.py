"""Moments as programs and the pages' scripts read them."""

import datetime as dt


def moment_text(moment: dt.datetime | None) -> str | None:
    """Return a moment as 2026-01-01T12:03:00Z."""
    return moment.strftime("%Y-%m-%dT%H:%M:%SZ") if moment else None
