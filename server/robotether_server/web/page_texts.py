"""What templates write often: moments, keys in groups, and a robot's state in words. Pure functions."""

import datetime as dt

from flask import Flask

from robotether_server.db.robots import Robot
from robotether_server.times import rfc3339
from robotether_server.web import audit_texts, close_reason_texts, refusal_texts

KEY_GROUP = 4
UNITS = ("B", "kB", "MB", "GB")
KILO = 1000


def register(app: Flask) -> None:
    """Give the templates their filters."""
    app.add_template_filter(timestamp_words, "timestamp")
    app.add_template_filter(end_text, "end_text")
    app.add_template_filter(audit_texts.sentence, "sentence")
    app.add_template_filter(close_reason_texts.drive_end, "drive_end")
    app.add_template_filter(close_reason_texts.session_end, "session_end")
    app.add_template_filter(refusal_texts.refusal)
    app.add_template_filter(key_groups, "key_groups")
    app.add_template_filter(state_words, "state_words")
    app.add_template_filter(size_words, "size")


def timestamp_words(timestamp: dt.datetime) -> str:
    """Return a moment as people read it: 2026-01-01 12:03 UTC."""
    return timestamp.astimezone(dt.UTC).strftime("%Y-%m-%d %H:%M UTC")


def end_text(timestamp: dt.datetime | None) -> str:
    """Return an end as its form takes it: 2026-01-31 for the last second of a day, else 2026-01-31T12:00:00Z."""
    return (rfc3339(timestamp) or "").replace("T23:59:59Z", "")


def key_groups(fingerprint: str) -> list[str]:
    """Split a fingerprint in groups that the eye can compare; together they are the fingerprint."""
    kind, colon, digest = fingerprint.rpartition(":")
    groups = [digest[at : at + KEY_GROUP] for at in range(0, len(digest), KEY_GROUP)]
    return [kind + colon, *groups] if kind else groups


def state_words(robot: Robot) -> str:
    """Return a robot's state in a word or two."""
    if robot.state != "pending":
        return robot.state.capitalize()
    return "Waits for approval" if robot.fingerprint else "Announced"


def size_words(count: int) -> str:
    """Return a number of bytes as people read it: 512 B, 181.2 MB."""
    value, unit = float(count), 0
    # What would be written as 1000.0 goes on to the next unit.
    while round(value, 1) >= KILO and unit < len(UNITS) - 1:
        value, unit = value / KILO, unit + 1
    return f"{value:.1f} {UNITS[unit]}" if unit else f"{count} B"
