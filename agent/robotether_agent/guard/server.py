"""The guard's door: takes WebSockets on a port of this machine, and joins those it lets in to rosbridge.

Run by the guard's process. The agent's forward of the robot's port leads here. Who may enter is the authority's
matter; rosbridge is reached before the upgrade, so that one that is down is an HTTP answer.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from http import HTTPStatus

import aiohttp
from aiohttp import web

from robotether_agent.guard.authority import KEY_HEADER, Admission, Authority, NotAdmitted
from robotether_agent.guard.helm import Helm
from robotether_agent.guard.joint import Joint
from robotether_agent.guard.orders import Config
from robotether_agent.guard.sockets import ClientSocket, open_rosbridge
from robotether_agent.reasons import why

ADDRESS = "127.0.0.1"
MOST_CONNECTIONS = 128
# The others are the server's, whoever came first: for the 64 observers and the driver that its relay lets in, and for
# those that left and are not gone yet when the next ones come. Its look-ups are no upgrades, and need no place.
MOST_DIRECT = 32
SHUTDOWN_S = 0.2

log = logging.getLogger(__name__)


class Server:
    """All connections of operators."""

    def __init__(
        self,
        http: aiohttp.ClientSession,
        authority: Authority,
        helm: Helm,
        config: Callable[[], Config | None],
        rosbridge_up: Callable[[], bool],
    ) -> None:
        self._http = http
        self._authority = authority
        self._helm = helm
        self._config = config
        self._rosbridge_up = rosbridge_up
        self._joints: set[Joint] = set()
        self._count = 0
        self._direct = 0
        # Cancellation ends a joint whose client is gone also while it waits for rosbridge.
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

    def end_those(self, concerned: Callable[[Admission], bool]) -> None:
        """End the connections with such an admission."""
        for joint in tuple(self._joints):
            if concerned(joint.admission):
                joint.end()

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
        if self._count >= MOST_CONNECTIONS or (direct and self._direct >= MOST_DIRECT):
            return _problem(503, f"{self._count} connections are open")
        self._count += 1
        self._direct += direct
        try:
            return await self._join(request, client, config)
        finally:
            self._count -= 1
            self._direct -= direct

    async def _join(
        self, request: web.BaseRequest, client: ClientSocket, config: Config | None
    ) -> web.StreamResponse:
        try:
            admission = self._authority.admit(request.headers)
        except NotAdmitted as refused:
            return _problem(refused.status, str(refused))
        # A newer lease than any before ends the older driver's connection.
        self.rights_changed()
        if config is None:
            return _problem(502, "the guard does not know where rosbridge is")
        joint = Joint(admission, client, self._helm, lambda: (self._config() or config).topics)
        self._joints.add(joint)
        try:
            return await self._serve(request, client, joint, config.rosbridge_url)
        finally:
            self._joints.discard(joint)

    async def _serve(
        self, request: web.BaseRequest, client: ClientSocket, joint: Joint, url: str
    ) -> web.StreamResponse:
        try:
            rosbridge = await open_rosbridge(self._http, url)
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            return _problem(502, f"rosbridge at {url} does not answer: {why(error, 3)}")
        try:
            await client.open(request)
            await joint.run(rosbridge)
        finally:
            rosbridge.drop()
            client.drop()
        return client

    def rights_changed(self) -> None:
        """Stop and end whoever may not drive any more."""
        self._helm.rights_changed()
        self.end_those(lambda admission: not self._authority.keeps(admission))


def _problem(status: int, text: str) -> web.Response:
    return web.Response(status=status, reason=HTTPStatus(status).phrase, text=text + "\n")
