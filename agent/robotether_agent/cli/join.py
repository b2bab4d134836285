"""`robotether-agent join`: asks the server once, in the foreground, and says in a sentence what it answered.

For installers and people. Safe beside a running agent, which asks again by itself.
"""

from __future__ import annotations

import asyncio
import logging
import sys

from robotether_agent.enrolment.enroller import Enroller
from robotether_agent.problems import NotEnrolled, Problem
from robotether_agent.settings import Settings
from robotether_agent.users import act_as_agent

ACTIVE, REFUSED, PENDING = 0, 1, 10


def join(settings: Settings) -> int:
    """Join, print the answer, and return ACTIVE, PENDING, or REFUSED for all that is in the way."""
    logging.basicConfig(level=logging.WARNING, format="robotether-agent: %(message)s")
    try:
        act_as_agent(settings.state_dir)
        return asyncio.run(_join(Enroller(settings)))
    except Problem as problem:
        print(f"robotether-agent: {problem}", file=sys.stderr)
        return REFUSED


async def _join(enroller: Enroller) -> int:
    key = await enroller.key()
    try:
        enrolment = await enroller.join()
    except NotEnrolled as problem:
        # Whoever approves it compares this with what the server got.
        shown = await enroller.next_key() or key
        print(f"pending: {problem.message} (key {shown.fingerprint})")
        if problem.advice:
            print(problem.advice)
        return PENDING
    print(f"active: {enrolment.server} knows this robot as {enrolment.robot} (MAC {enrolment.mac})")
    return ACTIVE
