"""How values are written on pages."""

from __future__ import annotations

import datetime as dt
import inspect
import re
from pathlib import Path
from typing import get_args

import pytest
import robotether_server
from robotether_common.guard import REFUSED_KINDS
from robotether_common.session import ByeCode
from robotether_server.db.audit import AuditEvent
from robotether_server.db.robots import RobotRow
from robotether_server.relay.channels.rosbridge.message_validator import Kind
from robotether_server.relay.drives.drive_path import GUARD
from robotether_server.relay.http import close_reasons
from robotether_server.web.page_texts import (
    DRIVES,
    EVENTS,
    KINDS,
    SESSIONS,
    drive_end,
    duration_words,
    key_groups,
    refusal,
    sentence,
    session_end,
    size_words,
    state_words,
    timestamp_words,
)

# What a relay writes of drives and sessions that the one before it left open.
BY_OTHERS = {"relay_restarted", "cell_removed"}
# Ends who watches alone: a drive has no pictures on its connection.
OF_VIDEO = {"video_down"}
NOON = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)


def test_moments_are_in_utc() -> None:
    """Whatever zone they come in."""
    noon = dt.datetime(2026, 1, 1, 12, 3, 59, tzinfo=dt.timezone(dt.timedelta(hours=2)))
    assert timestamp_words(noon) == "2026-01-01 10:03:59 UTC"


def test_groups_of_a_key_are_the_whole_key() -> None:
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
def test_a_state_in_words(state: str, fingerprint: str | None, words: str) -> None:
    """A robot that has not joined is told from one that waits."""
    robot = RobotRow(1, "02:00:00:00:00:01", "sim1", state, 1, 2, fingerprint, {})  # type: ignore[arg-type] # a state of the list above
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
def test_sizes_have_the_unit_that_makes_them_short(count: int, words: str) -> None:
    """A thousand of one is one of the next; after the last one it grows."""
    assert size_words(count) == words


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(-1, "0 s"), (7.6, "8 s"), (59.6, "1 min 0 s"), (95, "1 min 35 s"), (7500, "2 h 5 min")],
)
def test_durations_have_two_units_at_most(seconds: float, words: str) -> None:
    """Durations below an hour have seconds."""
    assert duration_words(seconds) == words


def test_every_refusal_has_words() -> None:
    """Those of the policy and those of the guard, and no other."""
    assert set(KINDS) == {*get_args(Kind), *(GUARD + kind for kind in REFUSED_KINDS)}


def test_unknown_refusal_is_shown_as_it_is() -> None:
    """A page tells what it can."""
    assert (refusal("guard_old"), refusal("eaten")) == ("too old at the robot", "eaten")


def test_every_ending_of_a_drive_has_words() -> None:
    """Those of the relay's own list, and no other."""
    written = set(re.findall(r'CloseReason\(\s*\w+, "([a-z_]+)"', inspect.getsource(close_reasons)))
    assert len(written) > 15
    assert set(DRIVES) == written - OF_VIDEO | BY_OTHERS
    assert written >= OF_VIDEO


def test_every_ending_of_a_session_has_words() -> None:
    """Those that the agent reads in `bye`, and no other."""
    assert set(SESSIONS) == set(get_args(ByeCode)) | BY_OTHERS


def test_unknown_code_is_shown_as_it_is() -> None:
    """A page tells what it can."""
    assert (drive_end("lease_lost"), drive_end("eaten")) == ("somebody else got control", "eaten")
    assert (session_end("timeout"), session_end("eaten")) == (SESSIONS["timeout"], "eaten")


def event(kind: str, robot: str | None = None, **details: object) -> AuditEvent:
    return AuditEvent(1, NOON, "root", kind, robot, None, details)


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (
            event("robot_settings_set", "sim1", was={}, settings={"region": "north"}),
            "changed the settings of sim1",
        ),
        (
            event("grant_given", "sim1", user="ann", level="drive"),
            "gave ann the right to drive sim1",
        ),
        (
            event("grant_taken", group="crew", site="lab", level="manage"),
            "took from group crew the right to manage site lab",
        ),
        (
            event("grant_given", user="ann", all=True, level="observe"),
            "gave ann the right to observe all robots",
        ),
        (event("robot_site_set", "sim1", site=None, was="lab"), "removed sim1 from its site"),
        (event("robot_shell_set", "sim1", shell=True), "turned the shell of sim1 on"),
        (event("robot_renamed", "sim2", was="sim1"), "renamed sim1 to sim2"),
        (event("lease_taken", "sim1", driver="ben"), "took control of sim1 from ben"),
        (event("lease_taken", "sim1"), "took control of sim1 from ?"),
        (event("never_heard_of", "sim1"), "never_heard_of"),
        (
            event("drive_ended", "sim1", end_code="client_left", fence=70, lasted_s=8.0),
            "stopped driving sim1 after 8 s (driver left)",
        ),
        (event("drive_ended", "sim1"), "stopped driving sim1"),
        (
            event("operations_refused", "sim1", topic=3, rate=12),
            "sent sim1 what is not allowed: 15 messages blocked",
        ),
        (event("user_added", user="{robot.id}", role="user"), "added user {robot.id}"),
    ],
)
def test_line_is_said_in_words(one: AuditEvent, words: str) -> None:
    """A detail that is missing is a question mark; what somebody chose as a name is no template."""
    assert sentence(one) == words


def test_every_event_has_words() -> None:
    """Those that the server's own modules write, as far as they stand there as a text."""
    source = "".join(
        path.read_text(encoding="utf-8")
        for path in Path(robotether_server.__file__).parent.rglob("*.py")
    )
    calls = r'(?:audit\.record\(\s*[\w.]+, [\w.]+,|_audit\((?:\s*report,)?)\s*"([a-z_]+)"'
    written = set(re.findall(calls, source))
    assert len(written) > 30
    assert written <= set(EVENTS)
    assert all(name and sentence(event(kind, "sim1")) for kind, (name, _) in EVENTS.items())
