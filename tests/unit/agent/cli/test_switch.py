"""The command as an upgrade calls it; what it does is tested with robotether_agent.upgrade."""

from __future__ import annotations

import json
import signal

import pytest
from robotether_agent.cli.main import main
from robotether_agent.versions import COMMAND, Layout


@pytest.fixture(autouse=True)
def hangup():
    """The command ignores the loss of its terminal; the tests do not."""
    before = signal.getsignal(signal.SIGHUP)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture
def environ(place, monkeypatch) -> dict[str, str]:
    """A robot with two versions whose service does not run; the double of systemctl says so."""
    for name in ("1", "2"):
        command = place / "opt/versions" / name / COMMAND
        command.parent.mkdir(parents=True)
        command.write_text("#!/bin/sh\n")
        command.chmod(0o755)
    Layout(place / "opt").use(place / "opt/versions/1")
    double = place / "systemctl"
    double.write_text("#!/bin/sh\necho inactive; exit 3\n")
    double.chmod(0o755)
    monkeypatch.setenv("PATH", f"{place}:/usr/bin:/bin")
    return {"ROBOTETHER_SERVER": "a.example", "ROBOTETHER_RUN_DIR": str(place / "run")}


def test_says_how_it_ended(environ, place, capsys):
    """In a line for a person and in a file for a program."""
    assert main(["switch", str(place / "opt/versions/2"), "--wait", "1"], environ) == 0
    assert capsys.readouterr().out == "done: 2 is in use\n"
    assert json.loads((place / "opt/last-switch.json").read_text())["result"] == "done"
    assert (place / "opt/current").readlink().name == "2"


def test_a_wrong_folder_is_impossible(environ, place, capsys):
    assert main(["switch", str(place / "opt/versions/3")], environ) == 1
    assert "name a folder in versions/" in capsys.readouterr().err
