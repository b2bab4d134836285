"""Runs the relay as a process: settings, log, event loop, and a stop on SIGTERM."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys

import uvloop

from robotether_server.problems import SettingsError
from robotether_server.relay.db.database import ThreadedDatabase
from robotether_server.relay.relay import Listen, Relay
from robotether_server.settings import RelaySettings, load_relay
from robotether_server.store import Database

log = logging.getLogger(__name__)

LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"


def main() -> None:
    """Run until SIGTERM or SIGINT."""
    try:
        settings = load_relay(os.environ)
    except SettingsError as problem:
        sys.exit(problem.detail)
    logging.basicConfig(level=settings.log_level.upper(), format=LOG_FORMAT)
    uvloop.run(run(settings, Listen()))
    logging.shutdown()
    # Threads that wait for a database that hangs would hold the interpreter's exit.
    os._exit(0)


async def run(settings: RelaySettings, listen: Listen) -> None:
    """Run a relay until the process is asked to stop."""
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopped.set)
    relay = Relay(settings, ThreadedDatabase(Database(settings.database)), listen=listen)
    await relay.start()
    await stopped.wait()
    log.info("stopping")
    await relay.stop()
