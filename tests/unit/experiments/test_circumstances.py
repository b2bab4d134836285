"""What is told of machine and versions is asked."""

from __future__ import annotations

import platform
import subprocess
from pathlib import Path

import pytest
from paper import circumstances
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


def test_the_experiments_own_pages_change_no_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A part that ends writes them anew; whatever else changed makes the sources dirty."""
    monkeypatch.setattr(circumstances, "ROOT", tmp_path)
    page, source = tmp_path / "docs/experiments/index.md", tmp_path / "agent.py"
    page.parent.mkdir(parents=True)
    for file in (page, source):
        file.write_text("before\n")
    person = ("-c", "user.name=a", "-c", "user.email=a@example.com")
    for words in (("init", "-q"), ("add", "."), (*person, "commit", "-qm", "a")):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    clean = commit()
    page.write_text("after\n")
    assert commit() == clean
    source.write_text("after\n")
    assert commit() == f"{clean}-dirty"


def test_every_daemon_is_asked_once() -> None:
    """Each has a name of its own."""
    assert len({name for _, name, _ in DAEMONS}) == len(DAEMONS)
