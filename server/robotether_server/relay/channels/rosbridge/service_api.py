"""Answers POST /api/v1/robots/NAME/services/SERVICE: calls a service of the robot's ROS.

Whoever sees the robot may call what observers may on /robots/NAME/ros. All else is a driver's: it needs the right to
drive, and the lease. A call shares its user's lease, or holds one until it is answered, so nobody calls while another
user drives or the robot is stopped. What ends a call that was sent ends nothing at the robot, and its answer says so.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace

from aiohttp import WebSocketError, WSMsgType, web
from msgspec import Raw, Struct
from robotether_common.ros import full_name

from robotether_server import schemas
from robotether_server.contract.ros import MAX_ARGS_BYTES, ServiceAnswer, ServiceArgs, ServiceQuery
from robotether_server.problems import HttpError, RobotetherError, ServiceTimeoutError
from robotether_server.relay.auth.access import Permit, request_of
from robotether_server.relay.channels.rosbridge.bridge import close_reason_of_gone_robot
from robotether_server.relay.channels.rosbridge.http_calls import (
    HttpCalls,
    check_message,
    read_raw,
)
from robotether_server.relay.channels.rosbridge.operations import NotJsonError, read_json
from robotether_server.relay.control.control import Control
from robotether_server.relay.http.close_reasons import CloseReason, ConnectionClosedError
from robotether_server.relay.http.sockets import (
    RobotSocket,
    close_reason_of_broken,
    why_closed,
)
from robotether_server.relay.robots.connection import Connection, Use

# The only one of its connection.
CALL_ID = "call"
# Time by which rosbridge's own limit is later, so that a call that takes too long has one answer.
LATER_BY_S = 1


class ServiceResponse(Struct):
    """What rosbridge answers to a call, or why it does not make it."""

    op: str
    id: object = None
    result: bool = True
    values: Raw = Raw(b"{}")
    level: str = ""
    msg: str = ""


@dataclass
class ServiceCall:
    """A call that is allowed: rosbridge's message, as what it is made, and whether it was sent to the robot."""

    service: str
    message: bytes
    use: Use
    timeout_s: int
    address: str | None
    is_sent: bool = False

    @property
    def outcome(self) -> str:
        """What is known of the service when the call ends without an answer."""
        return f"{self.service} may still run" if self.is_sent else f"{self.service} was not called"


@dataclass(frozen=True)
class ServiceApi:
    """Answers POST /api/v1/robots/NAME/services/SERVICE."""

    calls: HttpCalls
    control: Control

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Call the service, and answer with what it answers."""
        access, name = self.calls.context.access, request.match_info["name"]
        permit = await access.for_service(request_of(request), name)
        query = schemas.read_query(request.query.items(), ServiceQuery)
        service = request.match_info["service"]
        call = _allowed_call(request, permit, service, query, await _args(request))
        self.calls.context.registry.online_presence(permit.robot)
        try:
            return await self.calls.answer(
                request, permit, call.use, lambda connection: self._call(permit, call, connection)
            )
        except ConnectionClosedError as closed:
            reason = f"{closed.close_reason.reason}; {call.outcome}"
            raise ConnectionClosedError(replace(closed.close_reason, reason=reason)) from closed

    async def _call(
        self, permit: Permit, call: ServiceCall, connection: Connection
    ) -> ServiceAnswer:
        try:
            async with asyncio.timeout(call.timeout_s):
                if call.use == "observe":
                    return await self._ask(call, connection, None)
                await self.calls.context.check_credential(permit.credential, permit.robot)
                return await self._call_as_driver(call, connection)
        except TimeoutError as exc:
            raise ServiceTimeoutError(
                f"cannot call {call.service}: no answer within {call.timeout_s} s; {call.outcome}"
            ) from exc

    async def _call_as_driver(self, call: ServiceCall, connection: Connection) -> ServiceAnswer:
        leasing = self.control.leasing
        async with leasing.shared(connection) as fence:

            def end_without_lease() -> None:
                if (why := self._why_lost(connection, fence)) is not None:
                    connection.end(why)

            with self.control.watched(connection.robot.id, end_without_lease):
                leasing.audit_call(connection, call.service, call.address)
                return await self._ask(call, connection, fence)

    def _why_lost(self, connection: Connection, fence: int) -> CloseReason | None:
        """Return why a call may not drive any more; None: its lease lasts."""
        leasing = self.control.leasing
        driver = leasing.of(connection.robot.id).driver
        is_held = driver is not None and driver.fence == fence
        return None if is_held else leasing.why_lost(connection)

    async def _ask(
        self, call: ServiceCall, connection: Connection, fence: int | None
    ) -> ServiceAnswer:
        socket = await self.calls.context.dialer.open(connection.robot, fence)
        try:
            if fence is not None and (why_lost := self._why_lost(connection, fence)) is not None:
                # A stop came just when the robot was reached: the call's end waits for its turn.
                raise ConnectionClosedError(why_lost)
            with self.calls.context.counted_uplink(connection, socket.received_bytes):
                call.is_sent = True
                await socket.send_frame(call.message, WSMsgType.TEXT)
                return await self._response(socket, connection.robot.name)
        except ConnectionError as exc:
            why = await close_reason_of_gone_robot(connection.robot.name)
            raise ConnectionClosedError(why) from exc
        finally:
            socket.drop()

    async def _response(self, socket: RobotSocket, robot: str) -> ServiceAnswer:
        while True:
            message = await socket.next_message()
            if message.type is WSMsgType.TEXT or message.type is WSMsgType.BINARY:
                if (answer := _answer(message.data)) is not None:
                    return answer
            elif isinstance(message.data, WebSocketError):
                sender, limit = f"robot {robot}", self.calls.context.dialer.message_limit
                raise ConnectionClosedError(close_reason_of_broken(message.data, sender, limit))
            elif message.type is WSMsgType.CLOSE:
                why = why_closed(message)
                raise ConnectionClosedError(await close_reason_of_gone_robot(robot, why))
            else:
                raise ConnectionClosedError(await close_reason_of_gone_robot(robot))


def _allowed_call(
    request: web.Request, permit: Permit, service: str, query: ServiceQuery, args: ServiceArgs
) -> ServiceCall:
    """Return the call, as an observer's if observers may make it; raise why it is not allowed."""
    message = {
        "op": "call_service",
        "id": CALL_ID,
        "service": service,
        "type": query.type,
        "args": args,
        "timeout": query.timeout_s + LATER_BY_S,
    }
    use: Use = "observe"
    try:
        checked = check_message(permit.robot, "observe", message)
    except RobotetherError:
        # Of one who only observes that is refused again.
        checked, use = check_message(permit.robot, permit.level, message), "drive"
    address = request.headers.get("X-Forwarded-For")
    return ServiceCall(full_name(service) or service, checked.data, use, query.timeout_s, address)


async def _args(request: web.Request) -> ServiceArgs:
    data = await request.clone(client_max_size=MAX_ARGS_BYTES).read()
    if not data:
        return {}
    if request.content_type != "application/json":
        raise HttpError(415, "cannot read the body: send it as application/json")
    try:
        return read_json(data)
    except NotJsonError as exc:
        raise HttpError(400, f"cannot read the body: {exc.detail}") from exc


def _answer(data: bytes) -> ServiceAnswer | None:
    """Return the answer to the call; None for any other message."""
    response = read_raw(data, ServiceResponse)
    if response is None or response.id != CALL_ID:
        return None
    if response.op == "status" and response.level == "error":
        return ServiceAnswer(False, reason=response.msg)
    if response.op != "service_response":
        return None
    if response.result:
        return ServiceAnswer(True, response.values)
    return ServiceAnswer(False, reason=_reason(response.values))


def _reason(values: Raw) -> str:
    """Return rosbridge's reason, which it puts in the place of values."""
    reason = read_raw(bytes(values), str)
    return bytes(values).decode() if reason is None else reason
