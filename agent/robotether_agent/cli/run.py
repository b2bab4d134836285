"""`robotether-agent run`: connects and stays connected; the boot service runs this."""

from __future__ import annotations

import asyncio
import logging
import random
import signal
import time
from collections.abc import Mapping
from contextlib import suppress

from robotether_agent import log as logs
from robotether_agent.backoff import before_restart
from robotether_agent.daemon import Agent
from robotether_agent.notify import Notifier
from robotether_agent.problems import HostKeyChanged, Problem, SettingsInvalid
from robotether_agent.settings import Settings
from robotether_agent.tasks import within

# RestartPreventExitStatus of the unit: a person must look first.
NOT_RESTARTED = frozenset({HostKeyChanged.exit_code, SettingsInvalid.exit_code})

log = logging.getLogger(__name__)


def run(settings: Settings, environ: Mapping[str, str]) -> int:
    """Run the agent until it ends by itself or is told to, and return its exit code."""
    logs.set_up(settings.log_level, environ)
    notifier = Notifier.from_environ(environ)
    code = asyncio.run(_until_signal(settings, notifier))
    notifier.stopping()
    if code == 0:
        log.info("stopped")
    return code


async def _until_signal(settings: Settings, notifier: Notifier) -> int:
    """Run the agent until it ends by itself or is told to by SIGTERM or SIGINT."""
    agent = asyncio.ensure_future(_run(settings, notifier))
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        # Only the first one: a second cancellation would cut the orderly end short.
        loop.add_signal_handler(number, _cancel_once, agent)
    try:
        return await agent
    except asyncio.CancelledError:
        log.info("told to stop: closed the tunnels")
        return 0


async def _run(settings: Settings, notifier: Notifier) -> int:
    """Run the agent until it fails; return the exit code, in a service after a pause that fits."""
    rng, began_s = random.SystemRandom(), time.monotonic()
    try:
        await Agent(settings, notifier, rng).run()
    except Problem as problem:
        log.critical("STOPPED: %s", problem)
        code = problem.exit_code
    except Exception:
        log.exception("stopped by an error in the agent itself")
        code = 1
    else:
        return 0
    if notifier.is_service and code not in NOT_RESTARTED:
        await _pause(before_restart(time.monotonic() - began_s, rng), notifier)
    return code


async def _pause(wait_s: float, notifier: Notifier) -> None:
    notifier.status(f"failed; starts again in {wait_s:.0f} s")
    # systemd must not take the pause for a hanging loop.
    with suppress(asyncio.TimeoutError):
        await within(wait_s, notifier.keep_watchdog())


def _cancel_once(agent: asyncio.Future[int]) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.remove_signal_handler(number)
        signal.signal(number, signal.SIG_IGN)
    agent.cancel()
