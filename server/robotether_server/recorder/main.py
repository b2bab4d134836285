"""The recorder's process: reads its settings, and runs one `RecorderService` until it is asked to stop."""

from __future__ import annotations

import asyncio
import os
import signal
import sys

import uvloop
from aiohttp import ClientSession, ClientTimeout, web

from robotether_server import logs
from robotether_server.db import Database
from robotether_server.problems import SettingsError
from robotether_server.recorder.relay_client import RelayClient
from robotether_server.recorder.service import RecorderService
from robotether_server.recorder.store import RecorderStore
from robotether_server.settings.server import RecorderSettings, load
from robotether_server.tasks import run_until_first

# Port of the health check, inside the container alone.
HEALTH_PORT = 9101
CONNECT_WITHIN_S = 5.0


def main() -> None:
    """Run until SIGTERM or SIGINT."""
    try:
        settings = load(RecorderSettings, os.environ)
    except SettingsError as problem:
        sys.exit(problem.detail)
    logs.set_up(settings.log_level, settings.log_format)
    uvloop.run(run(settings))


async def run(settings: RecorderSettings) -> None:
    """Record until the process is asked to stop."""
    stopped = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stopped.set)
    timeout = ClientTimeout(total=None, sock_connect=CONNECT_WITHIN_S)
    async with ClientSession(timeout=timeout) as session:
        store = RecorderStore(Database(settings.database, keep=1), settings.cell)
        service = RecorderService(settings, RelayClient(settings, session), store)
        runner = await serve_health(service)
        await run_until_first(service.run(), stopped.wait())
        await service.close()
        await runner.cleanup()


async def serve_health(service: RecorderService) -> web.AppRunner:
    """Answer the health check."""

    async def healthz(_request: web.Request) -> web.Response:
        # A database or a relay that is away is no reason to begin anew: what is recorded goes on.
        return web.json_response({"status": "ok", "relay": service.channel.is_open})

    app = web.Application()
    app.router.add_get("/healthz", healthz)
    runner = web.AppRunner(app, access_log=None)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", HEALTH_PORT).start()
    return runner
