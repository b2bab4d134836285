"""One aiohttp application on one TCP port. Used by both servers of the simulated robot."""

import logging

from aiohttp import web

log = logging.getLogger(__name__)

SHUTDOWN_TIMEOUT_S = 1.0


class Listener:
    """Starts and stops an application; after the start `port` is the real one, also for port 0."""

    def __init__(self, name: str, app: web.Application) -> None:
        self._name = name
        self._runner = web.AppRunner(
            app, access_log=None, handle_signals=False, shutdown_timeout=SHUTDOWN_TIMEOUT_S
        )
        self.port = 0

    async def start(self, address: str, port: int) -> None:
        """Listen; OSError if the port is taken."""
        await self._runner.setup()
        await web.TCPSite(self._runner, address, port).start()
        self.port = self._runner.addresses[0][1]
        log.info("%s listens on %s:%d", self._name, address, self.port)

    async def stop(self) -> None:
        """End all connections."""
        await self._runner.cleanup()
