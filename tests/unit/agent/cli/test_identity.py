"""Which MAC an installer registers: the one that the agent will find later."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from fake_root import FakeRoot
from robotether_agent.cli.identity import identity
from robotether_agent.cli.main import main
from robotether_agent.settings import Settings, load

MAC = "00:1b:44:11:3a:b7"


@pytest.fixture
def root(tmp_path) -> FakeRoot:
    """A machine with one network card."""
    made = FakeRoot(tmp_path)
    made.add("eth0", MAC, 2)
    return made


def test_what_it_prints_is_kept(root, place, capsys):
    """Without a server in the settings, before any join, and also when another interface comes first later."""
    settings = load(None, {"ROBOTETHER_STATE_DIR": str(place / "state")}, needs_server=False)
    assert identity(settings, as_json=False, root=root.path) == 0
    assert capsys.readouterr().out == f"{MAC} eth0\n"
    root.add("wlan0", "00:1b:44:00:00:01", 3)
    root.route(("wlan0", 1))
    assert identity(settings, as_json=True, root=root.path) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"mac": MAC, "interface": "eth0", "is_present": True, "is_kept": True}


def test_a_mac_that_is_gone_is_told(root, place, capsys):
    """A person sees why, and a program finds is_present."""
    settings = Settings(server="", state_dir=place)
    identity(settings, as_json=False, root=root.path)
    root.remove("eth0")
    capsys.readouterr()
    identity(settings, as_json=False, root=root.path)
    assert capsys.readouterr().out == f"{MAC} eth0 (no interface of this machine has it now)\n"


def test_whoever_cannot_keep_it_may_still_look(root, capsys):
    """On a machine where nothing is installed there may be nowhere to write to."""
    settings = Settings(server="", state_dir=Path("/proc/none/state"))
    assert identity(settings, as_json=True, root=root.path) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["mac"], told["is_kept"]) == (MAC, False)


def test_rubbish_is_a_sentence(place, capsys):
    """A MAC that names no robot is told with where it was set and what is allowed."""
    environ = {"ROBOTETHER_STATE_DIR": str(place), "ROBOTETHER_MAC": "ff:ff:ff:ff:ff:ff"}
    assert main(["identity"], environ) == 78
    told = capsys.readouterr().err
    assert "cannot use ROBOTETHER_MAC = 'ff:ff:ff:ff:ff:ff'" in told
    assert "multicast or broadcast" in told
