"""One operator's WebSocket joined to one robot's rosbridge.

`rosbridge` makes a `Bridge` a connection, after `access` has let the operator in. What it sends to
the robot is what `operations` returns: a driver's messages as the bytes they came in, an observer's
written anew. It never parses what comes from a robot, and a message makes no task, no timer and no
queue entry of its own. Reading on one side waits for writing on the other, so that a connection's
memory is bounded by the socket buffers.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from aiohttp import WebSocketError, WSCloseCode, WSMsgType

from robotether_server.relay import endings, operations
from robotether_server.relay.endings import Ending
from robotether_server.relay.liveness import Limits, Liveness
from robotether_server.relay.sockets import OperatorSocket, RobotSocket

log = logging.getLogger(__name__)

# A tunnel that dies closes rosbridge's connection and the robot's session in either order; wait
# so long for the second, to tell the operator which of the two it was.
LINK_GRACE_S = 0.3


class EndedError(Exception):
    """Carries an ending out of code that connects."""

    def __init__(self, ending: Ending) -> None:
        super().__init__(ending.reason)
        self.ending = ending


@dataclass
class Traffic:
    """What all bridges have passed on since the start; `metrics` reads it."""

    messages_to_robot: int = 0
    messages_to_client: int = 0
    bytes_to_robot: int = 0
    bytes_to_client: int = 0
    refused: int = 0


@dataclass(frozen=True)
class BridgeRules:
    """What is the same for all bridges of a relay."""

    limits: Limits
    message_limit: int
    traffic: Traffic


class Bridge:
    """Passes messages between an operator and a robot until something ends it."""

    def __init__(
        self, robot: str, mode: operations.Mode, operator: OperatorSocket, rules: BridgeRules
    ) -> None:
        self._name = robot
        self._mode = mode
        self._operator = operator
        self._robot: RobotSocket | None = None
        self._rules = rules
        self._loop = asyncio.get_running_loop()
        self._ended: asyncio.Future[Ending] = self._loop.create_future()
        self._heard_at = self._loop.time()
        self._bytes_to_robot = 0
        self._bytes_to_client = 0

    def end(self, ending: Ending) -> None:
        """End the connection at once; the first ending counts."""
        if not self._ended.done():
            self._ended.set_result(ending)

    async def run(self, connect: Callable[[], Awaitable[RobotSocket]]) -> Ending:
        """Reach the robot and pass messages; return why that ended. `farewell` comes next."""
        if self._ended.done():
            return self._ended.result()
        work = asyncio.create_task(self._guard(self._work(connect)))
        try:
            return await self._ended
        finally:
            # The pumps must be still before the close frame, which is the last frame.
            work.cancel()
            await asyncio.gather(work, return_exceptions=True)

    async def ending_of_gone(self) -> Ending:
        """Return why a connection that is gone ended, by the frames that nobody has read yet."""
        if await self._operator.said_goodbye():
            return endings.client_left(self._name)
        return endings.client_vanished(self._name)

    async def farewell(self, ending: Ending) -> None:
        """Tell both sides that it ended."""
        await asyncio.gather(self._leave_robot(), self._operator.finish(ending))

    def release(self) -> None:
        """Let the robot go, also when the operator vanished and nobody could say farewell."""
        if self._robot is not None:
            self._robot.drop()

    async def _leave_robot(self) -> None:
        if self._robot is not None:
            await self._robot.leave()

    async def _guard(self, part: Coroutine[Any, Any, Ending]) -> None:
        """Run a part of the connection; its end, or its defect, ends the connection."""
        try:
            self.end(await part)
        except EndedError as exc:
            self.end(exc.ending)
        except Exception:
            log.exception("robot %s: an operator's connection failed", self._name)
            self.end(endings.relay_failed())

    async def _work(self, connect: Callable[[], Awaitable[RobotSocket]]) -> Ending:
        self._robot = robot = await connect()
        async with asyncio.TaskGroup() as group:
            group.create_task(self._guard(self._pump_to_robot(robot)))
            group.create_task(self._guard(self._pump_to_client(robot)))
            group.create_task(self._guard(self._watch(robot)))
        return await self._ended

    async def _pump_to_robot(self, robot: RobotSocket) -> Ending:
        operator, traffic, mode = self._operator, self._rules.traffic, self._mode
        while True:
            message = await operator.receive()
            self._heard_at = self._loop.time()
            try:
                if message.type is WSMsgType.TEXT:
                    data = operations.checked_text(message.data, mode)
                elif message.type is WSMsgType.BINARY:
                    data = operations.checked_binary(message.data, mode)
                elif message.type is WSMsgType.PING:
                    await operator.pong(message.data)
                    continue
                elif message.type is WSMsgType.PONG:
                    continue
                else:
                    return self._ending_by_operator(message.type, message.data)
            except operations.RefusedError as refused:
                traffic.refused += 1
                await self._send_to_client(refused.answer, WSMsgType.TEXT)
                continue
            traffic.messages_to_robot += 1
            traffic.bytes_to_robot += len(data)
            self._bytes_to_robot += len(data)
            try:
                await robot.send_frame(data, message.type)
            except ConnectionError:
                return await self._ending_by_robot("its connection broke")

    async def _pump_to_client(self, robot: RobotSocket) -> Ending:
        traffic = self._rules.traffic
        while True:
            message = await robot.receive()
            if message.type is not WSMsgType.TEXT and message.type is not WSMsgType.BINARY:
                return await self._ending_of_robot(message.type, message.data)
            traffic.messages_to_client += 1
            traffic.bytes_to_client += len(message.data)
            await self._send_to_client(message.data, message.type)

    async def _send_to_client(self, data: bytes, kind: WSMsgType) -> None:
        self._bytes_to_client += len(data)
        try:
            await self._operator.send_frame(data, kind)
        except ConnectionError as exc:
            raise EndedError(endings.client_vanished(self._name)) from exc

    async def _watch(self, robot: RobotSocket) -> Ending:
        limits, operator, loop = self._rules.limits, self._operator, self._loop
        liveness = Liveness(limits, loop.time())
        pinged_at = loop.time()
        while True:
            await asyncio.sleep(limits.look_every_s)
            now, waiting = loop.time(), operator.waiting_bytes()
            verdict = liveness.look(
                now,
                heard_at=self._heard_at,
                to_client=(self._bytes_to_client, waiting),
                to_robot=(self._bytes_to_robot, robot.waiting_bytes()),
            )
            if verdict == "client_silent":
                return endings.client_silent(self._name, limits.silent_after_s)
            if verdict == "client_slow":
                return endings.client_slow(self._name, limits.slow_after_s)
            if verdict == "robot_slow":
                why = f"it took nothing for {limits.slow_after_s:g} s"
                return endings.rosbridge_down(self._name, why)
            # Behind data that waits a ping would only wait too.
            if waiting == 0 and now - pinged_at >= limits.ping_every_s:
                pinged_at = now
                await self._ping()

    async def _ping(self) -> None:
        try:
            await self._operator.ping()
        except ConnectionError as exc:
            raise EndedError(endings.client_vanished(self._name)) from exc

    def _ending_by_operator(self, kind: WSMsgType, data: object) -> Ending:
        if kind is WSMsgType.CLOSE:
            return endings.client_left(self._name)
        if isinstance(data, WebSocketError):
            return _ending_of_broken(data, "you", self._operator.message_limit)
        return endings.client_vanished(self._name)

    async def _ending_of_robot(self, kind: WSMsgType, data: object) -> Ending:
        if kind is WSMsgType.CLOSE:
            return endings.rosbridge_down(self._name, "it closed the connection")
        if isinstance(data, WebSocketError):
            sender, limit = f"robot {self._name}", self._rules.message_limit
            return _ending_of_broken(data, sender, limit)
        return await self._ending_by_robot("its connection broke")

    async def _ending_by_robot(self, why: str) -> Ending:
        await asyncio.sleep(LINK_GRACE_S)
        return endings.rosbridge_down(self._name, why)


def _ending_of_broken(error: WebSocketError, sender: str, limit: int) -> Ending:
    if error.code == WSCloseCode.MESSAGE_TOO_BIG:
        return endings.message_too_big(limit, sender)
    return endings.protocol_broken(sender)
