"""How log lines look."""

from __future__ import annotations

import logging

from robotether_agent.log import JournalFormatter


def test_journal_lines_carry_their_priority():
    """Each line of a record has syslog's number in front, so that journalctl -p finds it."""
    formatter = JournalFormatter("%(message)s")
    record = logging.LogRecord("x", logging.WARNING, __file__, 1, "one\ntwo", None, None)
    assert formatter.format(record) == "<4>one\n<4>two"
