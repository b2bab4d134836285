"""The WebSocket server of rosbridge: takes connections and moves bytes between them and their clients.

Started by simulator.py. One client's slowness or rubbish must never reach another one or the robot's loop.
"""

import asyncio
import itertools
import logging

from aiohttp import WSCloseCode, WSMsgType, web

from sim_robot.graph import Graph
from sim_robot.rosbridge.client import Client, Outbox
from sim_robot.rosbridge.operations import handle

log = logging.getLogger(__name__)

MESSAGE_LIMIT_BYTES = 10_000_000  # as the real one's max_message_size
CLOSE_TIMEOUT_S = 1.0


class RosbridgeServer:
    """All connections of one robot's rosbridge."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._numbers = itertools.count(1)
        self._connections: set[web.WebSocketResponse] = set()
        self.app = web.Application()
        self.app.router.add_get("/", self._serve)
        self.app.on_shutdown.append(self._close_all)

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse(
            compress=False, max_msg_size=MESSAGE_LIMIT_BYTES, timeout=CLOSE_TIMEOUT_S
        )
        if not socket.can_prepare(request):
            return web.Response(status=400, text='Can "Upgrade" only to "WebSocket".')
        await socket.prepare(request)
        client = Client(self._graph, f"client {next(self._numbers)} ({request.remote})")
        self._connections.add(socket)
        log.debug("%s connected", client.name)
        writer = asyncio.create_task(_write(socket, client.outbox))
        try:
            await _read(socket, client)
        finally:
            self._connections.discard(socket)
            client.close()
            writer.cancel()
            await asyncio.gather(writer, return_exceptions=True)
            dropped = client.outbox.dropped
            level = logging.WARNING if dropped else logging.DEBUG
            log.log(level, "%s left, %d messages dropped", client.name, dropped)
        return socket

    async def _close_all(self, _app: web.Application) -> None:
        closing = (s.close(code=WSCloseCode.GOING_AWAY) for s in tuple(self._connections))
        await asyncio.gather(*closing, return_exceptions=True)


async def _read(socket: web.WebSocketResponse, client: Client) -> None:
    async for message in socket:
        # Some clients send their JSON in binary frames; the real server takes both.
        if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
            handle(client, message.data)


async def _write(socket: web.WebSocketResponse, outbox: Outbox) -> None:
    while True:
        data = await outbox.get()
        try:
            await socket.send_str(data)
        except ConnectionError:
            return  # the reader sees the end of the connection and cleans up
