"""Forgetting asks first, and says what it does."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from robotether_agent.cli.main import main
from robotether_agent.files import LOCK, ensure_directory, only_one


@pytest.fixture
def environ(place) -> dict[str, str]:
    """A robot with a key."""
    made = {
        "ROBOTETHER_STATE_DIR": str(place / "state"),
        "ROBOTETHER_RUN_DIR": str(place / "run"),
    }
    assert main(["key"], made) == 0
    return made


class Terminal(io.StringIO):
    """A person at a terminal, with an answer."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("answer", "code"), [("y\n", 0), ("yes\n", 0), ("\n", 1), ("n\n", 1)])
def test_a_person_is_asked(environ, capsys, monkeypatch, answer, code):
    """Only a yes removes anything; what goes is named, and that it cannot be undone."""
    monkeypatch.setattr("sys.stdin", Terminal(answer))
    assert main(["forget"], environ) == code
    told = capsys.readouterr().out
    assert "removes id_ed25519, id_ed25519.pub. This cannot be undone" in told
    assert Path(environ["ROBOTETHER_STATE_DIR"], "id_ed25519").exists() == bool(code)


def test_without_a_terminal_it_needs_a_word(environ, place, capsys, monkeypatch):
    """A script says --yes; a pipe by accident removes nothing. A second run has nothing to do."""
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert main(["forget"], environ) == 1
    assert "add --yes" in capsys.readouterr().out
    assert main(["forget", "--yes"], environ) == 0
    assert list((place / "state").iterdir()) == []
    assert main(["forget", "--yes"], environ) == 0
    assert "nothing to forget" in capsys.readouterr().out


def test_not_while_the_agent_runs(environ, place, capsys):
    ensure_directory(place / "run", "run_dir")
    with only_one(place / "run" / LOCK):
        assert main(["forget", "--yes"], environ) == 75
    assert "sudo systemctl stop robotether-agent" in capsys.readouterr().err
    assert (place / "state/id_ed25519").exists()
