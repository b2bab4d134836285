"""A request over HTTP that waits for a robot's ROS: a connection like others, with the same limits and ends.

`topic_api` and `service_api` make one for each request. What it may do is the `MessageValidator`'s matter, as on
/robots/NAME/ros.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec
from aiohttp import web
from msgspec import Struct

from robotether_server.db.fleet import RelayRobot
from robotether_server.problems import (
    FieldInvalidError,
    GrantMissingError,
    HttpError,
    RobotetherError,
    TooManyConnectionsError,
)
from robotether_server.relay.auth.access import HandlerContext, Permit
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.rosbridge.message_validator import (
    MessageRefusedError,
    MessageValidator,
    ValidatedMessage,
)
from robotether_server.relay.channels.rosbridge.operations import write_json
from robotether_server.relay.http.close_reasons import ConnectionClosedError
from robotether_server.relay.http.sockets import SEND_BUFFER_BYTES, OperatorConnection
from robotether_server.relay.robots.connection import Connection, Use
from robotether_server.robot_json import read_robot_json
from robotether_server.schemas import Level
from robotether_server.tasks import end_tasks

# Time limit for a client to take each piece of its answer.
TAKEN_WITHIN_S = 10.0
HEADERS = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}

Work = Callable[[Connection], Coroutine[Any, Any, Struct | None]]
T = TypeVar("T")


@dataclass(frozen=True)
class HttpCalls:
    """Answers requests that wait for a robot."""

    context: HandlerContext
    traffic: Traffic

    async def answer(
        self, request: web.Request, permit: Permit, use: Use, work: Work
    ) -> web.StreamResponse:
        """Do the work and answer with what it returns; 204 for None. Ends at once when the caller's right does."""
        call = HttpCall(request, permit.robot.name, self.traffic)
        level: Level = permit.level if use == "drive" else "observe"
        connection = Connection(
            permit.user.id, permit.user.name, permit.robot, use, call.end, level=level, is_call=True
        )
        if (why := self.context.connections.no_room(connection)) is not None:
            raise TooManyConnectionsError(f"cannot ask robot {permit.robot.name}: {why}")
        with self.context.counted(connection, permit.credential):
            return await call.run(work(connection))


class HttpCall(OperatorConnection):
    """One request until its client has the answer."""

    def __init__(self, request: web.Request, robot: str, traffic: Traffic) -> None:
        super().__init__(robot)
        self._request = request
        self._traffic = traffic

    async def run(self, work: Coroutine[Any, Any, Struct | None]) -> web.StreamResponse:
        """Do the work and send what it returns, until something ends this; raise what prevents an answer."""
        task = asyncio.create_task(self._answer(work), name=f"call of {self.name}")
        either: set[asyncio.Future[Any]] = {task, self._ended}
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
            raise ConnectionClosedError(self._ended.result())
        finally:
            await end_tasks([task])

    async def _answer(self, work: Coroutine[Any, Any, Struct | None]) -> web.StreamResponse:
        answer = await work
        if answer is None:
            return web.Response(status=204, headers=HEADERS)
        body = msgspec.json.encode(answer)
        with self._traffic.taken(self, len(body)):
            return await self._send(memoryview(body))

    async def _send(self, body: memoryview) -> web.StreamResponse:
        """Send an answer within the limits of memory and time; one that is cut short ends the connection."""
        response = web.StreamResponse(headers=HEADERS)
        response.content_type, response.charset = "application/json", "utf-8"
        response.content_length = len(body)
        try:
            await response.prepare(self._request)
            for start in range(0, len(body), SEND_BUFFER_BYTES):
                async with asyncio.timeout(TAKEN_WITHIN_S):
                    await response.write(body[start : start + SEND_BUFFER_BYTES])
            await response.write_eof()
        except BaseException as error:
            if self._request.transport is not None:
                self._request.transport.abort()
            if not isinstance(error, TimeoutError):
                raise
        return response


def check_message(
    robot: RelayRobot, level: Level, message: Mapping[str, object]
) -> ValidatedMessage:
    """Return what may go to a robot, by the rules of a connection of this level; raise the problem when nothing may."""
    settings = robot.settings
    policy = settings.policy
    validator = MessageValidator(policy.of(level), settings.guard.drive_topics, policy.limits)
    fields = {name: value for name, value in message.items() if value is not msgspec.UNSET}
    try:
        return validator.check(write_json(fields))
    except MessageRefusedError as refused:
        raise _problem(refused) from refused


def read_raw(data: bytes, type_: type[T]) -> T | None:
    """Read JSON that a robot sent, whose `Raw` parts may go into an answer; None when it is no such JSON.

    msgspec leaves what is inside of `Raw` unread: it may nest deeper than it counts, and be no UTF-8.
    """
    try:
        value = read_robot_json(data, type_)
        data.decode()
    except (ValueError, RecursionError):
        return None
    return value


def _problem(refused: MessageRefusedError) -> RobotetherError:
    if refused.kind in {"topic", "service"}:
        return GrantMissingError(refused.detail)
    if refused.kind == "size":
        return HttpError(413, refused.detail)
    return FieldInvalidError(refused.detail)
