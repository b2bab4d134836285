"""The public half of the robot's key, before it knows any server."""

from __future__ import annotations

import re

from robotether_agent.cli.main import main


def test_prints_the_same_line_each_time(place, capsys):
    """An installer registers what it prints; the private half stays where it is."""
    environ = {"ROBOTETHER_STATE_DIR": str(place / "state")}
    printed = set()
    for _ in range(2):
        assert main(["key"], environ) == 0
        printed.add(capsys.readouterr().out)
    (line,) = printed
    assert re.fullmatch(r"ssh-ed25519 AAAA\S+\n", line)
    assert (place / "state/id_ed25519").stat().st_mode & 0o777 == 0o600
