"""Which of the server's addresses is tried, and in which order."""

from __future__ import annotations

from pathlib import Path

import pytest
from robotether_agent.dialer import Dialer
from robotether_agent.enroller import Enroller
from robotether_agent.enrolment import Enrolment, SshAccess
from robotether_agent.settings import Settings


@pytest.mark.parametrize(
    ("host", "settings", "expected"),
    [
        (None, {}, ["a.example port 2222", "a.example port 443"]),
        ("ssh.example", {}, ["ssh.example port 2222", "ssh.example port 443"]),
        ("ssh.example", {"ssh_host": "b.example", "ssh_ports": (22,)}, ["b.example port 22"]),
    ],
)
def test_the_settings_come_before_the_joins_answer(host, settings, expected):
    """And a join that names no host means the one that it went to."""
    values = Settings(server="a.example:8443", state_dir=Path("/none"), **settings)
    enrolment = Enrolment(
        "a.example:8443", "sim1", "00:1b:44:11:3a:b7", SshAccess("tunnel", host, (2222, 443))
    )
    targets = Dialer(values, Enroller(values)).targets(enrolment)
    assert [str(target) for target in targets] == expected
