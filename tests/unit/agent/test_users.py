"""Whose files a command makes that a person starts with sudo; with the real system calls where root runs it."""

from __future__ import annotations

import os
import pwd
import subprocess
import sys
from pathlib import Path

import pytest
from robotether_agent import users
from robotether_agent.users import act_as_agent, become_owner

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
WHO = "import os; print(os.geteuid(), os.getegid(), len(os.getgroups()))"


def as_child(code: str) -> str:
    """Run Python in a process of its own, since a right that is dropped never comes back."""
    environ = {"PATH": os.environ["PATH"], "PYTHONPATH": ":".join(sys.path)}
    command = [sys.executable, "-c", code]
    return subprocess.run(
        command, check=True, capture_output=True, text=True, env=environ
    ).stdout.strip()


def child_in(place: Path, more: str) -> str:
    return as_child(
        f"from pathlib import Path; from robotether_agent import users; {more.format(place=place)}; {WHO}"
    )


@needs_root
def test_root_becomes_the_owner_of_the_state(place):
    """What it writes there belongs to the boot service."""
    nobody = pwd.getpwnam("nobody")
    place.chmod(0o755)
    state = place / "state"
    state.mkdir()
    os.chown(state, nobody.pw_uid, nobody.pw_gid)
    told = child_in(place, "users.act_as_agent(Path('{place}/state'))")
    assert told.split()[:2] == [str(nobody.pw_uid), str(nobody.pw_gid)]


@needs_root
def test_a_missing_directory_is_made_for_the_agents_user(place):
    """Before the boot service ran for the first time there is none."""
    nobody = pwd.getpwnam("nobody")
    place.chmod(0o755)
    more = "users.AGENT_USER = 'nobody'; users.act_as_agent(Path('{place}/new/state'))"
    assert child_in(place, more).split()[0] == str(nobody.pw_uid)
    made = (place / "new/state").stat()
    assert (made.st_uid, made.st_mode & 0o777) == (nobody.pw_uid, 0o700)


def test_who_is_not_root_stays_who_it_is(place, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    before = os.getuid()
    act_as_agent(place / "none")
    become_owner(place)
    assert os.getuid() == before
    assert not (place / "none").exists()


@needs_root
def test_without_the_agents_user_root_stays_root(place, monkeypatch):
    monkeypatch.setattr(users, "AGENT_USER", "no-such-user")
    act_as_agent(place / "none")
    act_as_agent(place)
    become_owner(place / "none")
    assert os.geteuid() == 0
