"""What lies behind a virtual robot's forwards: a guard's answers, a rosbridge that echoes, and its topics.

Who may enter is decided by the guard's own rules. A published message goes to all who subscribe to its topic, without
the relay's stamp; a command is neither limited nor followed by zeros, and the guard never says that the robot moves.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, NoReturn

from aiohttp import WSMsgType, web
from robotether_agent.guard.authorizer import Authorizer, DriveNotAuthorizedError
from robotether_agent.guard.topics import Authorization
from robotether_agent.tunnel.openssh import ServiceAddress
from robotether_agent.tunnel.session import Session
from robotether_common.guard import REFUSED_KINDS, STOP_CAUSES
from robotether_common.topics import PATH

LOCALHOST = "127.0.0.1"
Said = dict[str, Any]


class Services:
    """One robot's, on ports of this machine once it is started."""

    def __init__(self) -> None:
        self.moved = asyncio.Event()
        self._say: Callable[[str | None], None] = lambda _: None
        self._authorizer = Authorizer(time.monotonic())
        self._by = ""
        self._reported_fence = 0
        self._closing: set[asyncio.Task[bool]] = set()
        self._clients: dict[web.WebSocketResponse, Authorization] = {}
        # By whoever hears it.
        self._topics: dict[web.WebSocketResponse, str] = {}
        self._servers: list[asyncio.Server] = []

    async def __aenter__(self) -> Services:
        loop = asyncio.get_running_loop()
        for answer in (self._answer_ros, self._answer_topics):
            server = web.Server(answer, access_log=None, handler_cancellation=True)
            self._servers.append(await loop.create_server(server, LOCALHOST, 0))
        return self

    async def __aexit__(self, *_: object) -> None:
        for server in self._servers:
            server.close()

    def ros_target(self) -> ServiceAddress:
        return self._address(0)

    def topics_target(self) -> ServiceAddress:
        return self._address(1)

    def _address(self, number: int) -> ServiceAddress:
        return ServiceAddress(LOCALHOST, self._servers[number].sockets[0].getsockname()[1])

    async def report(self, session: Session) -> NoReturn:

        def say(answers: str | None) -> None:
            session.send({"type": "guard", **self._guard, "answers": answers})

        self._say = say
        say(None)
        try:
            await asyncio.Event().wait()
        finally:
            self._say = lambda _: None
        raise AssertionError

    @property
    def _guard(self) -> Mapping[str, Any]:
        return {
            "state": "ready",
            "stopped": self._authorizer.stopped,
            "by": self._by,
            "moving": False,
            "fence": self._authorizer.fence,
            "unheard": [],
            "blind_limits": True,
            "refused": dict.fromkeys(REFUSED_KINDS, 0),
            "stops": dict.fromkeys(STOP_CAUSES, 0),
        }

    # What the session brings.

    def on_config(self, guard: Mapping[str, Any], *, direct: bool) -> None:
        self._authorizer.key, self._authorizer.direct = guard["key"], direct
        self._authorizer.session(up=True)

    def on_session_lost(self) -> None:
        self._authorizer.session(up=False)
        self._rights_changed()

    def on_lease(self, fence: int, *, held: bool) -> None:
        self._authorizer.lease(fence, held=held)
        self._rights_changed()

    def on_stop(self, message_id: str, by: str) -> None:
        self._authorizer.stop()
        self._by = by
        self._rights_changed()
        self._say(message_id)

    def on_release(self, message_id: str, by: str) -> None:
        del by
        self._authorizer.release()
        self._by = ""
        self._say(None)
        self._say(message_id)

    def _rights_changed(self) -> None:
        if self._authorizer.fence != self._reported_fence:
            self._reported_fence = self._authorizer.fence
            self._say(None)
        for client, authorization in list(self._clients.items()):
            if not self._authorizer.keeps(authorization):
                del self._clients[client]
                closing = asyncio.ensure_future(client.close(code=1001))
                self._closing.add(closing)
                closing.add_done_callback(self._closing.discard)

    async def _answer_ros(self, request: web.BaseRequest) -> web.StreamResponse:
        client = web.WebSocketResponse(timeout=0.5, compress=False, max_msg_size=16 * 1024 * 1024)
        if not client.can_prepare(request):
            return web.Response(status=426, text="connect with a WebSocket\n")
        try:
            authorization = self._authorizer.authorize(request.headers)
        except DriveNotAuthorizedError as refused:
            return web.Response(status=refused.status, text=f"{refused}\n")
        self._rights_changed()
        await client.prepare(request)
        self._clients[client] = authorization
        with suppress(ConnectionError):
            try:
                async for message in client:
                    if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                        await self._handle(client, json.loads(message.data))
            finally:
                self._clients.pop(client, None)
        return client

    async def _answer_topics(self, request: web.BaseRequest) -> web.StreamResponse:
        client = web.WebSocketResponse(timeout=0.5, compress=False)
        if request.path != PATH or not client.can_prepare(request):
            return web.Response(status=404)
        await client.prepare(request)
        with suppress(ConnectionError, TypeError):
            self._topics[client] = json.loads(await client.receive_str())["topic"]
            try:
                await client.receive()
            finally:
                del self._topics[client]
        return client

    async def _handle(self, client: web.WebSocketResponse, said: Said) -> None:
        if said["op"] == "publish":
            await self._publish(said)
        elif said["op"] == "call_service":
            # Any service succeeds, with nothing.
            answer = {"op": "service_response", "values": {}, "result": True}
            await client.send_json({**answer, "service": said["service"], "id": said.get("id")})

    async def _publish(self, said: Said) -> None:
        topic, message = said["topic"], said["msg"]
        text = ""
        for client, heard in list(self._topics.items()):
            if topic == heard:
                text = text or json.dumps({"op": "publish", "topic": topic, "msg": message})
                with suppress(ConnectionError):
                    await client.send_str(text)
