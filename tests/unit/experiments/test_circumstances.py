"""What is told of machine and versions is asked."""

from __future__ import annotations

import platform

import pytest
from paper.circumstances import DAEMONS, commit, machine, version_in


@pytest.mark.parametrize(
    ("said", "version"),
    [
        ("nginx version: nginx/1.26.3", "1.26.3"),
        ("OpenSSH_10.0p2 Debian-7+deb13u4, OpenSSL 3.5.7 9 Jun 2026", "10.0p2"),
        ("mariadbd  Ver 11.8.6-MariaDB-0+deb13u1 for debian-linux-gnu", "11.8.6"),
        ("Python 3.13.5\n", "3.13.5"),
        ("no idea\n", "no idea"),
    ],
)
def test_version_is_the_first_number_that_a_daemon_tells(said: str, version: str) -> None:
    """All of its words, where there is no number."""
    assert version_in(said) == version


def test_machine_tells_what_it_is() -> None:
    """Cores that this process may use, memory, kernel."""
    told = machine()
    assert told["cores"] >= 1
    assert told["memory_gb"] > 0
    assert platform.release().startswith(told["kernel"])
    assert told["processor"]


def test_commit_is_always_told() -> None:
    """A tree without git's folder is measured, too."""
    assert commit()


def test_every_daemon_is_asked_once() -> None:
    """Each has a name of its own."""
    assert len({name for _, name, _ in DAEMONS}) == len(DAEMONS)
