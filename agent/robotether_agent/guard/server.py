"""Accepts WebSockets on a local port, and connects authorized ones to rosbridge.

Run by the guard's process. The agent's forward of the robot's port leads here. Who may enter is the authorizer's
matter; rosbridge is reached before the upgrade, so that one that is down is an HTTP answer.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from http import HTTPStatus

import aiohttp
from aiohttp import web
from robotether_common.guard import KEY_HEADER

from robotether_agent.describe_error import describe_error
from robotether_agent.guard.agent_messages import GuardConfig
from robotether_agent.guard.authorization import (
    Authorization,
    Authorizer,
    NotAuthorized,
)
from robotether_agent.guard.client_proxy import ClientProxy, ClientSocket
from robotether_agent.guard.drive_controller import DriveController
from robotether_agent.guard.rosbridge import open_rosbridge

ADDRESS = "127.0.0.1"
MAX_CONNECTIONS = 128
# The others are the server's, whoever came first: for the 64 observers and the driver that its relay lets in, and for
# those that left and are not gone yet when the next ones come. Its look-ups are no upgrades, and need no place.
MAX_DIRECT_CONNECTIONS = 32
SHUTDOWN_S = 0.2

log = logging.getLogger(__name__)


class Server:
    """All connections of operators."""

    def __init__(
        self,
        http: aiohttp.ClientSession,
        authorizer: Authorizer,
        controller: DriveController,
        config: Callable[[], GuardConfig | None],
        rosbridge_up: Callable[[], bool],
    ) -> None:
        self._http = http
        self._authorizer = authorizer
        self._controller = controller
        self._config = config
        self._rosbridge_up = rosbridge_up
        self._proxies: set[ClientProxy] = set()
        self._count = 0
        self._direct = 0
        # Cancellation ends a client proxy whose client is gone also while it waits for rosbridge.
        server = web.Server(self._answer, handler_cancellation=True, access_log=None)
        self._runner = web.ServerRunner(server, shutdown_timeout=SHUTDOWN_S)

    async def start(self) -> int:
        """Listen; return the port, which the kernel chooses."""
        await self._runner.setup()
        await web.TCPSite(self._runner, ADDRESS, 0).start()
        port: int = self._runner.addresses[0][1]
        return port

    async def stop(self) -> None:
        """End all connections."""
        self.end_those(lambda _: True)
        await self._runner.cleanup()

    def end_those(self, concerned: Callable[[Authorization], bool]) -> None:
        """End the connections with such an admission."""
        for proxy in tuple(self._proxies):
            if concerned(proxy.authorization):
                proxy.end()

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        client = ClientSocket()
        config = self._config()
        if not client.can_prepare(request):
            down = config is None or not self._rosbridge_up()
            return (
                _problem(502, "rosbridge is down")
                if down
                else _problem(426, "connect with a WebSocket")
            )
        direct = KEY_HEADER not in request.headers
        if self._count >= MAX_CONNECTIONS or (direct and self._direct >= MAX_DIRECT_CONNECTIONS):
            return _problem(503, f"{self._count} connections are open")
        self._count += 1
        self._direct += direct
        try:
            return await self._join(request, client, config)
        finally:
            self._count -= 1
            self._direct -= direct

    async def _join(
        self, request: web.BaseRequest, client: ClientSocket, config: GuardConfig | None
    ) -> web.StreamResponse:
        try:
            authorization = self._authorizer.authorize(request.headers)
        except NotAuthorized as refused:
            return _problem(refused.status, str(refused))
        # A newer lease than any before ends the older driver's connection.
        self.rights_changed()
        if config is None:
            return _problem(502, "the guard does not know where rosbridge is")
        proxy = ClientProxy(
            authorization, client, self._controller, lambda: (self._config() or config).topics
        )
        self._proxies.add(proxy)
        try:
            return await self._serve(request, client, proxy, config.rosbridge_url)
        finally:
            self._proxies.discard(proxy)

    async def _serve(
        self, request: web.BaseRequest, client: ClientSocket, proxy: ClientProxy, url: str
    ) -> web.StreamResponse:
        try:
            rosbridge = await open_rosbridge(self._http, url)
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            return _problem(502, f"rosbridge at {url} does not answer: {describe_error(error, 3)}")
        try:
            await client.open(request)
            await proxy.run(rosbridge)
        finally:
            rosbridge.drop()
            client.drop()
        return client

    def rights_changed(self) -> None:
        """Stop and end whoever may not drive any more."""
        self._controller.rights_changed()
        self.end_those(lambda authorization: not self._authorizer.keeps(authorization))


def _problem(status: int, text: str) -> web.Response:
    return web.Response(status=status, reason=HTTPStatus(status).phrase, text=text + "\n")
