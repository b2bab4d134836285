"""`robotether-agent identity`: the MAC address that names this robot, by the agent's own rule.

Ansible asks this before it registers the robot, so what it prints is kept: the agent finds the same later.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from robotether_agent.enrolment.enrolment_store import EnrolmentStore
from robotether_agent.enrolment.identity_store import IdentityStore
from robotether_agent.files import ensure_directory
from robotether_agent.problems import StateUnusable
from robotether_agent.settings import Settings
from robotether_agent.users import act_as_agent


def identity(settings: Settings, *, as_json: bool, root: Path = Path("/")) -> int:
    """Print MAC and interface; without the right to keep them, print only."""
    # Anybody may look, also on a robot that is not installed yet.
    with suppress(StateUnusable):
        act_as_agent(settings.state_dir)
        ensure_directory(settings.state_dir, "state_dir", 0o700)
    store = IdentityStore(settings, root)
    known = EnrolmentStore(settings.state_dir).load(settings.server)
    found = store.identity(known.mac if known else None)
    if as_json:
        print(json.dumps({**asdict(found), "is_kept": store.is_kept(found)}))
    else:
        absent = "" if found.is_present else " (no interface of this machine has it now)"
        print(f"{found.mac} {found.interface or '-'}{absent}")
    return 0
