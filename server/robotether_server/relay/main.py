"""The relay's process: reads its settings, and runs one `Relay` until it is asked to stop."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys

import uvloop

from robotether_server import logs
from robotether_server.problems import SettingsError
from robotether_server.relay.cells.keys import read_peer_keys
from robotether_server.relay.http.event_loop import EventLoop, prepare_process, watched
from robotether_server.relay.options import Listen
from robotether_server.relay.records.database import open_database
from robotether_server.relay.records.journal import JOURNAL, Journal
from robotether_server.relay.wiring import Relay
from robotether_server.settings.server import RelaySettings, load

log = logging.getLogger(__name__)


def main() -> None:
    """Run until SIGTERM or SIGINT."""
    try:
        settings = load(RelaySettings, os.environ)
    except SettingsError as problem:
        sys.exit(problem.detail)
    logs.set_up(settings.log_level, settings.log_format)
    prepare_process()
    uvloop.run(watched(run(settings, Listen(), Journal(JOURNAL))), loop_factory=EventLoop)
    logging.shutdown()
    # Threads that wait for a database that hangs would hold the interpreter's exit.
    os._exit(0)


async def run(settings: RelaySettings, listen: Listen, journal: Journal | None = None) -> None:
    """Run a relay until the process is asked to stop."""
    stopped = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stopped.set)
    database, peer_keys = open_database(settings), read_peer_keys()
    relay = Relay(settings, database, listen=listen, peer_keys=peer_keys, journal=journal)
    await relay.start()
    await stopped.wait()
    log.info("stopping")
    await relay.stop()
