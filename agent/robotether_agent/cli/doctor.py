"""`robotether-agent doctor`: one line a step, and for each that fails what is wrong and what to do."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from robotether_agent.doctor.findings import FAIL, WARNING, fail
from robotether_agent.doctor.runner import run_checks
from robotether_agent.problems import SettingsInvalid
from robotether_agent.settings import Settings
from robotether_agent.users import become_owner


def doctor(load: Callable[[], Settings]) -> int:
    """Print all findings, and return 0 only when nothing fails."""
    try:
        settings = load()
    except SettingsInvalid as problem:
        print(fail("settings", problem.message, problem.advice))
        return 1
    # What root may read and write tells nothing about the agent.
    become_owner(settings.state_dir)
    return asyncio.run(_run_checks(settings))


async def _run_checks(settings: Settings) -> int:
    failed = warned = 0
    async for finding in run_checks(settings):
        print(finding, flush=True)
        failed += finding.state == FAIL
        warned += finding.state == WARNING
    well = "all works, but see the warning" if warned else "all is well"
    print(f"{failed} of these steps failed" if failed else well)
    return 1 if failed else 0
