"""`robotether-agent run`: connects and stays connected; the boot service runs this."""

from __future__ import annotations

import asyncio
import logging
import random
import signal
from collections.abc import Mapping

from robotether_agent import log as logs
from robotether_agent.agent import Agent
from robotether_agent.notify import Notifier
from robotether_agent.problems import Problem
from robotether_agent.settings import Settings

log = logging.getLogger(__name__)


def run(settings: Settings, environ: Mapping[str, str]) -> int:
    """Run the agent until it ends by itself or is told to, and return its exit code."""
    logs.set_up(settings.log_level, environ)
    try:
        asyncio.run(_until_signal(settings, Notifier.from_environ(environ)))
    except Problem as problem:
        log.critical("STOPPED: %s", problem)
        return problem.exit_code
    except Exception:
        log.exception("stopped by an error in the agent itself")
        return 1
    log.info("stopped")
    return 0


async def _until_signal(settings: Settings, notifier: Notifier) -> None:
    """Run the agent until it ends by itself or is told to by SIGTERM or SIGINT."""
    agent = asyncio.ensure_future(Agent(settings, notifier, random.SystemRandom()).run())
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        # Only the first one: a second cancellation would cut the orderly end short.
        loop.add_signal_handler(number, _cancel_once, agent)
    try:
        await agent
    except asyncio.CancelledError:
        log.info("told to stop: closed the tunnels")


def _cancel_once(agent: asyncio.Future[None]) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.remove_signal_handler(number)
        signal.signal(number, signal.SIG_IGN)
    agent.cancel()
