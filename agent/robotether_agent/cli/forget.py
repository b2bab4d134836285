"""`robotether-agent forget`: makes this machine a stranger again, so that its disk can be copied.

Run by a person as root, outside of the boot service's own hardening, while the agent is stopped.
"""

from __future__ import annotations

import sys

from robotether_agent.enrolment.unenrol import enrolment_files, unenrol
from robotether_agent.settings import Settings
from robotether_agent.users import act_as_agent


def forget(settings: Settings, *, yes: bool) -> int:
    """Remove what makes this machine the robot that it is, after asking."""
    act_as_agent(settings.state_dir)
    files = enrolment_files(settings.state_dir)
    if not files:
        print(f"nothing to forget: {settings.state_dir} holds no key and no enrolment")
        return 0
    if not yes and not _confirmed([path.name for path in files]):
        print("nothing was removed")
        return 1
    unenrol(settings)
    print("forgotten: at its next start this machine joins as a robot of its own, with a new key")
    return 0


def _confirmed(names: list[str]) -> bool:
    print(
        f"This removes {', '.join(names)}. This cannot be undone: the server then sees a new key."
    )
    if not sys.stdin.isatty():
        print("To go on without a terminal, add --yes.")
        return False
    return input("Forget this robot? [y/N] ").strip().lower() in {"y", "yes"}
