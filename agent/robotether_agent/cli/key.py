"""`robotether-agent key`: makes the robot's key if there is none, and prints its public half."""

from __future__ import annotations

import asyncio

from robotether_agent.enrolment.enroller import Enroller
from robotether_agent.settings import Settings
from robotether_agent.users import act_as_agent


def key(settings: Settings) -> int:
    """Print the public key as one line `ssh-ed25519 AAAA...`."""
    act_as_agent(settings.state_dir)
    print(asyncio.run(Enroller(settings).key()).public)
    return 0
