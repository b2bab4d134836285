"""Lets a command that a person starts with sudo write as the agent's own user.

Called by the cli before it touches the state directory: a file that root left there would lock the boot
service out of its own state. Never raises rights, only drops them.
"""

from __future__ import annotations

import os
import pwd
from pathlib import Path

from robotether_agent.problems import StateUnusable

AGENT_USER = "robotether"


def act_as_agent(state_dir: Path) -> None:
    """Become the owner of `state_dir`, which is made for the user robotether if it is missing."""
    if os.geteuid() != 0:
        return
    try:
        if not state_dir.exists():
            _make(state_dir)
    except OSError as error:
        raise StateUnusable(
            f"cannot make the directory {state_dir}: {error.strerror}",
            advice="see that the disk is neither full nor read-only, or set state_dir to another place",
        ) from error
    become_owner(state_dir)


def become_owner(state_dir: Path) -> None:
    """Become the owner of `state_dir`, if root asks and there is one."""
    if os.geteuid() != 0 or not state_dir.exists():
        return
    owner = _user(state_dir.stat().st_uid)
    # In a container root itself may be the agent's user.
    if owner is not None and owner.pw_uid != 0:
        os.initgroups(owner.pw_name, owner.pw_gid)
        os.setgid(owner.pw_gid)
        os.setuid(owner.pw_uid)


def _make(state_dir: Path) -> None:
    owner = _user(AGENT_USER)
    if owner is not None:
        state_dir.mkdir(mode=0o700, parents=True)
        os.chown(state_dir, owner.pw_uid, owner.pw_gid)


def _user(who: str | int) -> pwd.struct_passwd | None:
    """Return an account; an installation without a user of its own has none."""
    try:
        return pwd.getpwuid(who) if isinstance(who, int) else pwd.getpwnam(who)
    except KeyError:
        return None
