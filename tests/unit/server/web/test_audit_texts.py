"""The lines of the audit log in words."""

from __future__ import annotations

import datetime as dt
import re
from pathlib import Path

import pytest
import robotether_server
from robotether_server.db.audit import AuditEvent
from robotether_server.web.audit_texts import SENTENCES, sentence

NOON = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)
# They tell of robots and keys in their own details, which say more than a sentence would.
WITHOUT_WORDS = {"key_released", "mac_changed"}
BY_DETAILS = {"grant_given", "grant_taken", "robot_site_set", "robot_shell_set"}


def event(kind: str, robot: str | None = None, **details: object) -> AuditEvent:
    return AuditEvent(1, NOON, "root", kind, robot, None, details)


@pytest.mark.parametrize(
    ("one", "words"),
    [
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
        (event("robot_site_set", "sim1", site=None, was="lab"), "put sim1 at no site"),
        (event("robot_shell_set", "sim1", shell=True), "turned the shell of sim1 on"),
        (event("robot_renamed", "sim2", was="sim1"), "renamed sim1 to sim2"),
        (event("lease_taken", "sim1", driver="ben"), "took the control of sim1 from ben"),
        (event("lease_taken", "sim1"), "took the control of sim1 from ?"),
        (event("never_heard_of", "sim1"), ""),
        (event("user_added", user="{robot.id}", role="user"), "added user {robot.id}"),
    ],
)
def test_line_is_said_in_words(one: AuditEvent, words: str) -> None:
    """A detail that is missing is a question mark; what somebody chose as a name is no template."""
    assert sentence(one) == words


def test_every_kind_has_words() -> None:
    """Those that the server's own modules write, as far as they stand there as a text."""
    source = "".join(
        path.read_text(encoding="utf-8")
        for path in Path(robotether_server.__file__).parent.rglob("*.py")
    )
    written = set(re.findall(r'(?:Event\(\s*|_audit\(\s*(?:report, )?)"([a-z_]+)"', source))
    assert len(written) > 30
    assert written <= set(SENTENCES) | BY_DETAILS | WITHOUT_WORDS
