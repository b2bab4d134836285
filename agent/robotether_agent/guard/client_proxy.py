"""Connects one operator's WebSocket to a rosbridge connection of its own.

Made by the server for each handshake that was let in. Frames pass as they came, except that drive messages go to the
drive controller, and what cannot be checked is refused. It never reads what comes from the robot. Reading on one side
waits for writing on the other, so its memory is bounded by the socket buffers and one message each way. Text stays
bytes, and pings and pongs go on to the other side as they come.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress
from typing import Literal

from aiohttp import WSMsgType, web
from robotether_common.guard import RefusedKind

from robotether_agent.guard.authorization import Authorization
from robotether_agent.guard.drive_controller import DriveController
from robotether_agent.guard.drive_messages import (
    DriveTopics,
    MessageId,
    Unclear,
    drive_message,
)
from robotether_agent.guard.rosbridge import FAREWELL_S, SEND_BUFFER_BYTES, RosbridgeSocket
from robotether_agent.tasks import first_of, within

# The relay takes 10 MB; reading a message holds up all others, and the zeros.
FROM_CLIENT_BYTES = 16 * 1024 * 1024
# Of each kind of refusal.
ANSWER_EVERY_S = 1.0
# A client that takes nothing gets no answers either.
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
        """Tell how much of what was sent is still in this process."""
        return self._transport.get_write_buffer_size() if self._transport else 0

    async def leave(self, code: int) -> None:
        """Say goodbye, without waiting for long for a client that does not read."""
        with suppress(asyncio.TimeoutError, ConnectionError):
            await within(FAREWELL_S, self.close(code=code))

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
        self._client = client
        self._controller = controller
        self._topics = topics
        self._clock = asyncio.get_running_loop().time
        self._answered_at: dict[RefusedKind, float] = {}
        self._answers: set[asyncio.Task[None]] = set()
        self._over = asyncio.Event()

    def end(self) -> None:
        """End the connection: its right is over."""
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
            # A side that broke is told nothing, the other one is.
            with suppress(ConnectionError):
                await first_of(
                    self._to_robot(rosbridge), self._to_client(rosbridge), self._until_over()
                )
        finally:
            # Before anything waits: what this connection moves must stop now.
            self._controller.on_disconnected(self)
            for task in tuple(self._answers):
                task.cancel()
        await asyncio.gather(rosbridge.leave(), self._client.leave(_code(rosbridge.close_code)))

    async def _until_over(self) -> None:
        await self._over.wait()

    async def _to_robot(self, rosbridge: RosbridgeSocket) -> None:
        client = self._client
        while True:
            message = await client.receive()
            kind = message.type
            if kind is WSMsgType.TEXT or kind is WSMsgType.BINARY:
                if await self._passes(message.data):
                    await rosbridge.send_frame(message.data, kind)
            elif kind is WSMsgType.PING or kind is WSMsgType.PONG:
                await rosbridge.send_frame(message.data, kind)
            else:
                return

    async def _passes(self, data: bytes) -> bool:
        """Tell whether a message may go on as it is; a drive message goes to the drive controller."""
        try:
            message = drive_message(data, self._topics())
        except Unclear as unclear:
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
                return
            await client.send_frame(message.data, kind)

    async def _answer(self, data: bytes) -> None:
        # A client that is gone is seen by `run`.
        with suppress(ConnectionError):
            await self._client.send_frame(data, WSMsgType.TEXT)


def _code(of_rosbridge: int | None) -> int:
    return GOING_AWAY if of_rosbridge is None or of_rosbridge in NEVER_SENT else of_rosbridge
