"""The command `robotether-agent`: run (by systemd), status, show-settings.

The only module that reads the environment and sets the exit code; it prints, the others log.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import os
import random
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from robotether_agent import __version__, log
from robotether_agent.agent import Agent
from robotether_agent.notify import Notifier
from robotether_agent.problems import Problem
from robotether_agent.settings import DEFAULT_FILE, Settings, load, shown
from robotether_agent.status import CONNECTED, is_alive, read_status, render

logger = logging.getLogger(__name__)


def main(arguments: Sequence[str] | None = None, environ: Mapping[str, str] = os.environ) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        settings = load(options.config, environ)
        if options.command == "show-settings":
            print("\n".join(shown(settings)))
            return 0
        if options.command == "status":
            return _status(settings)
        return _run(settings, environ)
    except Problem as problem:
        print(f"robotether-agent: {problem}", file=sys.stderr)
        return problem.exit_code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="robotether-agent",
        description="Keeps this robot's tunnel to its Robotether server open.",
    )
    parser.add_argument("--version", action="version", version=f"robotether-agent {__version__}")
    parser.add_argument("--config", type=Path, help=f"settings file (usually {DEFAULT_FILE})")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("run", help="connect and stay connected; the boot service runs this")
    commands.add_parser("status", help="tell how the running agent is; exit code 0 when connected")
    commands.add_parser("show-settings", help="print the settings in force, secrets hidden")
    return parser


def _status(settings: Settings) -> int:
    status, now = read_status(settings.run_dir), time.time()
    if status is None:
        print(f"state         not running (no status in {settings.run_dir})")
        print("what to do    start it: sudo systemctl start robotether-agent")
        return 1
    print(render(status, now))
    return 0 if status.state == CONNECTED and is_alive(status, now) else 1


def _run(settings: Settings, environ: Mapping[str, str]) -> int:
    log.set_up(settings.log_level, environ)
    try:
        asyncio.run(_until_signal(settings, Notifier.from_environ(environ)))
    except Problem as problem:
        logger.critical("STOPPED: %s", problem)
        return problem.exit_code
    except Exception:
        logger.exception("stopped by an error in the agent itself")
        return 1
    logger.info("stopped")
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
        logger.info("told to stop: closed the tunnels")


def _cancel_once(agent: asyncio.Future[None]) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.remove_signal_handler(number)
        signal.signal(number, signal.SIG_IGN)
    agent.cancel()
