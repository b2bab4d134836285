"""What the audit log's lines say."""

import datetime as dt
import re
from pathlib import Path

import pytest
import robotether_server
from robotether_server.contract.audit import AUDIT_KINDS, AuditEvent, sentence

NOON = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)


def event(kind, robot=None, **details):
    return AuditEvent(1, NOON, "root", kind, robot, None, details)


@pytest.mark.parametrize(
    ("event", "words"),
    [
        (
            event("grant_taken", group="crew", site="lab", level="manage"),
            "took from group crew the right to manage site lab",
        ),
        (event("lease_taken", "sim1"), "took control of sim1 from ?"),
        (event("never_heard_of", "sim1"), "never_heard_of"),
        (event("user_added", user="{robot.id}", role="user"), "added user {robot.id}"),
    ],
)
def test_line_is_said_in_words(event, words):
    """A detail that is missing is a question mark; what somebody chose as a name is no template."""
    assert sentence(event) == words


def test_every_event_has_words():
    source = "".join(
        path.read_text(encoding="utf-8")
        for path in Path(robotether_server.__file__).parent.rglob("*.py")
    )
    calls = r'(?:audit\.record\(\s*[\w.]+, [\w.]+,|_audit\((?:\s*report,)?)\s*"([a-z_]+)"'
    written = set(re.findall(calls, source))
    assert len(written) > 30
    assert written <= set(AUDIT_KINDS)
    assert all(name and sentence(event(kind, "sim1")) for kind, (name, _) in AUDIT_KINDS.items())
