"""Tables and waits of the commands."""

import datetime as dt

import pytest
from robotether_server.cli import common


def test_nothing_steers_the_terminal(capsys):
    """What a stranger gave as a name is spelt out, in tables and records, and makes no line of its own."""
    name = "\x1b[2Jroot\nann\u202e\x9b"
    common.print_table(("WHO", "X"), [(name, "1")])
    common.print_fields([("who", name)])
    out = capsys.readouterr().out
    spelt = r"\x1b[2Jroot\nann\u202e\x9b"
    assert out == f"{'WHO'.ljust(len(spelt))}  X\n{spelt}  1\nwho  {spelt}\n"


def test_json_has_moments_as_text(capsys):
    """And nothing that a program would have to guess at."""
    common.print_json([dt.datetime(2026, 1, 2, 3, 4, 5, tzinfo=dt.UTC)])
    assert capsys.readouterr().out == '[\n  "2026-01-02T03:04:05+00:00"\n]\n'
    with pytest.raises(TypeError, match="has no place in JSON"):
        common.print_json([object()])
