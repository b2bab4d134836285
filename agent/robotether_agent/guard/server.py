"""Accepts operators' WebSockets on a local port, and connects each authorized one to rosbridge.

Run by the guard's process. The agent's forward of the robot's port leads here. The authorizer decides who may enter;
rosbridge is connected before the upgrade, so that a failure there is an HTTP answer.

A `ClientProxy` passes frames unchanged, except that drive messages go to the drive controller, and messages that cannot
be checked are rejected. It never reads the robot's messages. Reading on one side waits for writing on the other, so its
memory is bounded by the socket buffers and one message each way. Text stays bytes; pings and pongs pass, too.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from contextlib import suppress
from http import HTTPStatus
from typing import Literal

import aiohttp
from aiohttp import WSMsgType, web
from robotether_common.guard import (
    DISK_REFUSED,
    KEY_HEADER,
    MODE_HEADER,
    REASON_HEADER,
    RefusedKind,
)

from robotether_agent.describe_error import describe_error
from robotether_agent.fields import printable
from robotether_agent.guard.agent_messages import GuardConfig
from robotether_agent.guard.authorizer import Authorizer, DriveNotAuthorizedError
from robotether_agent.guard.drive_controller import DriveController
from robotether_agent.guard.drive_messages import (
    DriveMessageUnclearError,
    DriveTopics,
    MessageId,
    drive_message,
)
from robotether_agent.guard.seen_age import DriverView
from robotether_agent.guard.topics import Authorization
from robotether_agent.problems import StateUnusableError
from robotether_agent.rosbridge_socket import (
    CONNECT_WITHIN_S,
    FAREWELL_S,
    SEND_BUFFER_BYTES,
    RosbridgeSocket,
    close_reason,
    open_rosbridge,
    why_ended,
)
from robotether_agent.tasks import first_of, within

ADDRESS = "127.0.0.1"
MAX_CONNECTIONS = 128
# Maximum number of connections that do not drive. The others are reserved for the driver's, of which
# each call over HTTP is one. Look-ups are no upgrades and do not count.
MAX_OTHER_CONNECTIONS = 96
# Maximum number of connections without a key. The others are reserved for the relay's 64 observers.
MAX_DIRECT_CONNECTIONS = 32
SHUTDOWN_S = 0.2

# Maximum size of a client's message; the relay accepts 10 MB.
FROM_CLIENT_BYTES = 16 * 1024 * 1024
# Minimum interval between answers to refusals of the same kind.
ANSWER_EVERY_S = 1.0
# Maximum size of unsent answers; a client that reads nothing gets no more.
ANSWERS_WAITING_BYTES = 16 * 1024
GOING_AWAY = 1001
# RFC 6455 reserves these for connections that ended without a code.
NEVER_SENT = (0, 1005, 1006, 1015)


class ClientSocket(web.WebSocketResponse[Literal[False]]):
    """The operator's end."""

    def __init__(self) -> None:
        super().__init__(
            timeout=FAREWELL_S,
            autoping=False,
            compress=False,
            max_msg_size=FROM_CLIENT_BYTES,
            writer_limit=SEND_BUFFER_BYTES,
            decode_text=False,
        )
        self._transport: asyncio.Transport | None = None

    async def open(self, request: web.BaseRequest) -> None:
        """Answer the upgrade."""
        self._transport = request.transport
        if self._transport is not None:
            self._transport.set_write_buffer_limits(high=SEND_BUFFER_BYTES)
        await self.prepare(request)

    def waiting_bytes(self) -> int:
        """Return how much of what was sent is still in this process."""
        return self._transport.get_write_buffer_size() if self._transport else 0

    async def leave(self, code: int, why: str) -> None:
        """Say goodbye and why, without waiting for long for a client that does not read."""
        with suppress(asyncio.TimeoutError, ConnectionError):
            await within(FAREWELL_S, self.close(code=code, message=close_reason(why)))

    def drop(self) -> None:
        """End the connection at once; a client that has taken all that was sent keeps it, and its reason."""
        if self._transport is None:
            return
        if self._transport.get_write_buffer_size():
            self._transport.abort()
        else:
            self._transport.close()


class ClientProxy:
    """Implements `topics.CommandSource`."""

    def __init__(
        self,
        authorization: Authorization,
        client: ClientSocket,
        controller: DriveController,
        topics: Callable[[], DriveTopics],
    ) -> None:
        self.authorization = authorization
        self.view = DriverView()
        self._client = client
        self._controller = controller
        self._topics = topics
        self._clock = asyncio.get_running_loop().time
        self._answered_at: dict[RefusedKind, float] = {}
        self._answers: set[asyncio.Task[None]] = set()
        self._over = asyncio.Event()
        # Why it ends, for people: what rosbridge said, or `end`.
        self._why = "the connection to rosbridge broke"

    def end(self, why: str) -> None:
        """End the connection."""
        self._why = why
        self._over.set()

    def refuse(self, kind: RefusedKind, text: str, message_id: MessageId) -> None:
        """Answer as rosbridge does, at most once a second for each kind."""
        now = self._clock()
        if now - self._answered_at.get(kind, -ANSWER_EVERY_S) < ANSWER_EVERY_S:
            return
        self._answered_at[kind] = now
        status: dict[str, object] = {"op": "status", "level": "error"}
        if message_id is not None:
            status["id"] = message_id
        self.notify(json.dumps({**status, "msg": text}).encode())

    def notify(self, data: bytes) -> None:
        """Send a status to the client, unless it does not read."""
        if self._client.closed or self._client.waiting_bytes() > ANSWERS_WAITING_BYTES:
            return
        task = asyncio.ensure_future(self._answer(data))
        self._answers.add(task)
        task.add_done_callback(self._answers.discard)

    async def run(self, rosbridge: RosbridgeSocket) -> None:
        """Pass frames until a side ends, or `end` is called; then end both."""
        try:
            # A side that broke is not notified, the other one is.
            with suppress(ConnectionError):
                await first_of(
                    self._to_robot(rosbridge), self._to_client(rosbridge), self._over.wait()
                )
        finally:
            # Before anything waits: what this connection moves must stop now.
            self._controller.on_disconnected(self)
            for task in tuple(self._answers):
                task.cancel()
        await asyncio.gather(
            rosbridge.leave(), self._client.leave(_code(rosbridge.close_code), self._why)
        )

    async def _to_robot(self, rosbridge: RosbridgeSocket) -> None:
        client = self._client
        while True:
            message = await client.receive()
            if self._over.is_set():
                # The robot may be stopped: what still waits in the socket must not reach it.
                return
            kind = message.type
            if kind is WSMsgType.TEXT or kind is WSMsgType.BINARY:
                if await self._passes(message.data):
                    await rosbridge.send_frame(message.data, kind)
            elif kind is WSMsgType.PING or kind is WSMsgType.PONG:
                await rosbridge.send_frame(message.data, kind)
            else:
                return

    async def _passes(self, data: bytes) -> bool:
        """Return whether a message may go on as it is; a drive message goes to the drive controller."""
        try:
            message = drive_message(data, self._topics())
        except DriveMessageUnclearError as unclear:
            text = f"cannot pass a message: {unclear.why}"
            self._controller.refuse(self, unclear.kind, text, unclear.message_id)
            return False
        if message is None:
            return True
        await self._controller.handle(self, message)
        return False

    async def _to_client(self, rosbridge: RosbridgeSocket) -> None:
        client = self._client
        while True:
            message = await rosbridge.receive()
            kind = message.type
            if kind not in (WSMsgType.TEXT, WSMsgType.BINARY, WSMsgType.PING, WSMsgType.PONG):
                self._why = why_ended(message) or "rosbridge closed the connection"
                return
            await client.send_frame(message.data, kind)

    async def _answer(self, data: bytes) -> None:
        # A client that is gone is seen by `run`.
        with suppress(ConnectionError):
            await self._client.send_frame(data, WSMsgType.TEXT)


class Server:
    """All connections of operators."""

    def __init__(
        self,
        http: aiohttp.ClientSession,
        authorizer: Authorizer,
        controller: DriveController,
        config: Callable[[], GuardConfig | None],
        rosbridge_up: Callable[[], bool],
        *,
        keep_fence: Callable[[int], Awaitable[None]],
    ) -> None:
        self._http = http
        self._authorizer = authorizer
        self._controller = controller
        self._config = config
        self._rosbridge_up = rosbridge_up
        self._keep_fence = keep_fence
        self._proxies: set[ClientProxy] = set()
        self._count = 0
        self._others = 0
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
        self.end_those(lambda _: True, "its guard ends")
        await self._runner.cleanup()

    def end_those(self, concerned: Callable[[Authorization], bool], why: str) -> None:
        """End the connections with such an authorization."""
        for proxy in tuple(self._proxies):
            if concerned(proxy.authorization):
                proxy.end(why)

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
        other = direct or request.headers.get(MODE_HEADER) != "drive"
        if not self._has_room(other=other, direct=direct):
            return _problem(503, f"{self._count} connections are open")
        self._count += 1
        self._others += other
        self._direct += direct
        try:
            return await self._join(request, client, config)
        finally:
            self._count -= 1
            self._others -= other
            self._direct -= direct

    def _has_room(self, *, other: bool, direct: bool) -> bool:
        """Return whether another connection may come: one that does not drive, one without a key."""
        return (
            self._count < MAX_CONNECTIONS
            and not (other and self._others >= MAX_OTHER_CONNECTIONS)
            and not (direct and self._direct >= MAX_DIRECT_CONNECTIONS)
        )

    async def _join(
        self, request: web.BaseRequest, client: ClientSocket, config: GuardConfig | None
    ) -> web.StreamResponse:
        try:
            authorization = self._authorizer.authorize(request.headers)
        except DriveNotAuthorizedError as refused:
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
            await self._keep_fence(proxy.authorization.fence)
        except StateUnusableError as problem:
            return _problem(DISK_REFUSED, f"cannot drive: {problem.message}")
        try:
            rosbridge = await open_rosbridge(self._http, url)
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
            why = describe_error(error, CONNECT_WITHIN_S)
            return _problem(502, f"rosbridge at {url} does not answer: {why}", why)
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
        why = "its guard reports that the right to drive is over"
        self.end_those(lambda authorization: not self._authorizer.keeps(authorization), why)


def _problem(status: int, text: str, why: str = "") -> web.Response:
    """Answer with a sentence; the relay passes on `why`, which may be shorter."""
    headers = {REASON_HEADER: printable(why or text.removeprefix("cannot drive: "))}
    phrase = HTTPStatus(status).phrase
    return web.Response(status=status, reason=phrase, text=text + "\n", headers=headers)


def _code(of_rosbridge: int | None) -> int:
    return GOING_AWAY if of_rosbridge is None or of_rosbridge in NEVER_SENT else of_rosbridge
