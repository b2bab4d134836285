"""The environment of the agent's own programs, which run beside it: the guard and the encoder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import robotether_common

import robotether_agent

# Where the agent's packages lie: one folder once they are installed, two in a checkout.
PACKAGE_PARENTS = tuple(
    dict.fromkeys(
        str(Path(package.__path__[0]).resolve().parent)
        for package in (robotether_agent, robotether_common)
    )
)
# What only the agent itself may say to systemd.
NOT_INHERITED = frozenset({"NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC"})


def program_environment(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the agent's environment without its settings: its programs need no join token.

    They are those that came with this agent, whatever else Python would find.
    """
    inherited = {
        name: value
        for name, value in environ.items()
        if not name.startswith("ROBOTETHER_") and name not in NOT_INHERITED
    }
    paths = [*PACKAGE_PARENTS, *filter(None, [environ.get("PYTHONPATH")])]
    return {**inherited, "PYTHONPATH": os.pathsep.join(paths)}
