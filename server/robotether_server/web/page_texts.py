"""Texts for the templates: times, keys, states; with those of codes and audit lines, which contract/ has. Pure."""

import datetime as dt
from collections.abc import Mapping
from functools import partial

from flask import Flask
from markupsafe import Markup

from robotether_server.contract.audit import sentence
from robotether_server.contract.codes import DRIVE_ENDS, RECORDING_ENDS, REFUSALS, SESSION_ENDS
from robotether_server.db.robots import RobotRow
from robotether_server.times import duration_words, rfc3339

KEY_GROUP = 4
UNITS = ("B", "kB", "MB", "GB")
KILO = 1000


def register(app: Flask) -> None:
    """Give the templates their filters."""
    app.add_template_filter(timestamp_words, "timestamp")
    app.add_template_filter(time_element, "time")
    app.add_template_filter(end_value, "end_value")
    app.add_template_filter(rfc3339, "rfc3339")
    app.add_template_filter(sentence, "sentence")
    app.add_template_filter(partial(_words_of, DRIVE_ENDS), "drive_end")
    app.add_template_filter(partial(_words_of, RECORDING_ENDS), "recording_end")
    app.add_template_filter(duration_words, "duration")
    app.add_template_filter(session_end, "session_end")
    app.add_template_filter(partial(_words_of, REFUSALS), "refusal")
    app.add_template_filter(key_groups, "key_groups")
    app.add_template_filter(state_words, "state_words")
    app.add_template_filter(size_words, "size")
    app.add_template_filter(whole_sentence)


def whole_sentence(words: str) -> str:
    """Return what a problem says as a sentence; a program's name, such as web_video_server, keeps its small letter."""
    begins_with_name = "_" in words.partition(" ")[0]
    begun = words if begins_with_name else words[:1].upper() + words[1:]
    return begun if begun.endswith((".", "!", "?")) else f"{begun}."


def timestamp_words(timestamp: dt.datetime) -> str:
    """Return a time as a page without scripts shows it: 2026-01-01 12:03:59 UTC."""
    return timestamp.astimezone(dt.UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def time_element(timestamp: dt.datetime) -> Markup:
    """Return a time as markup: in the reader's own zone by src/pages/desk.js, in UTC on hover and without scripts."""
    words = timestamp_words(timestamp)
    return Markup('<time datetime="{}" title="{}">{}</time>').format(
        timestamp.isoformat(), words, words
    )


def end_value(timestamp: dt.datetime | None) -> str:
    """Return an end as a field of time has it: in UTC, to the minute, without its zone."""
    return timestamp.astimezone(dt.UTC).strftime("%Y-%m-%dT%H:%M") if timestamp else ""


def key_groups(fingerprint: str) -> list[str]:
    """Split a fingerprint in groups that the eye can compare; together they are the fingerprint."""
    kind, colon, digest = fingerprint.rpartition(":")
    groups = [digest[at : at + KEY_GROUP] for at in range(0, len(digest), KEY_GROUP)]
    return [kind + colon, *groups] if kind else groups


def state_words(robot: RobotRow) -> str:
    """Return a robot's state in a word or two."""
    if robot.state != "pending":
        return robot.state.capitalize()
    return "Awaiting approval" if robot.fingerprint else "Announced"


def size_words(count: int) -> str:
    """Return a number of bytes as people read it: 512 B, 181.2 MB."""
    value, unit = float(count), 0
    # What would be written as 1000.0 goes on to the next unit.
    while round(value, 1) >= KILO and unit < len(UNITS) - 1:
        value, unit = value / KILO, unit + 1
    return f"{value:.1f} {UNITS[unit]}" if unit else f"{count} B"


def _words_of(texts: Mapping[str, str], code: str) -> str:
    """Return what is said of a code; one that is not known stays as it is."""
    return texts.get(code, code)


def session_end(code: str) -> str:
    """Return why a robot's session ended."""
    return SESSION_ENDS[code].why if code in SESSION_ENDS else code
