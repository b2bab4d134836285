"""Answers the HTTP requests stop, release, lease, control and uplink.

`app` routes them here. A request shows a login or a token, never a ticket; what a login changes must come
from a page of this site. Handlers decide who may, `leasing` and `stops` do it.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import partial

import msgspec
from aiohttp import web
from msgspec import UNSET, Struct

from robotether_server import schemas
from robotether_server.contract.control import (
    LeaseAction,
    RobotQuery,
    ShownStop,
    SiteStop,
    StoppedRobot,
    StoppedRobotList,
    StopReason,
    press_of,
)
from robotether_server.contract.uplink import UplinkObject
from robotether_server.db.fleet import RelayRobot, RelayUser, Snapshot
from robotether_server.db.grants import includes
from robotether_server.problems import (
    FieldInvalidError,
    GrantMissingError,
    HttpError,
    RobotetherError,
)
from robotether_server.relay.auth.access import Access, request_of
from robotether_server.relay.control.control import Control
from robotether_server.relay.control.leasing import LeaseRequester
from robotether_server.relay.robots.media_dialer import MediaDialer
from robotether_server.schemas import Level

NO_STORE = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}


@dataclass(frozen=True)
class ControlApi:
    """Answers what asks for control over HTTP.

    `confirmation_elsewhere` waits until the guard of a robot at another cell has its stop; None: the robot is at no
    other. `unreached` names the cells that this one cannot reach now, which learn of a stop later.
    """

    access: Access
    control: Control
    media: MediaDialer
    snapshot: Callable[[], Snapshot]
    confirmation_elsewhere: Callable[[int], Awaitable[bool] | None]
    unreached: Callable[[], list[str]]

    def routes(self) -> list[web.RouteDef]:
        """Return the paths of the contract that are answered here."""
        return [
            web.get("/api/v1/robots/{name}/control", self.show),
            web.get("/api/v1/robots/{name}/uplink", self.show_uplink),
            web.post("/api/v1/robots/{name}/stop", self.stop),
            web.post("/api/v1/robots/{name}/release", self.release),
            web.post("/api/v1/robots/{name}/lease", self.lease),
            web.post("/api/v1/stop", self.stop_many),
        ]

    async def show(self, request: web.Request) -> web.Response:
        """Answer with the control object."""
        _, robot = await self._viewer_and_robot(request)
        return self._answer(robot)

    async def show_uplink(self, request: web.Request) -> web.Response:
        """Answer with what fills the uplink: whoever may see the robot, as everybody who watches fills it."""
        user, robot = await self._viewer_and_robot(request)
        registry = self.media.registry
        registry.online_presence(robot)
        uplink = registry.ensure_robot(robot.id).uplink
        streams, line_rate = await asyncio.gather(
            uplink.measured(user.id), uplink.line_rate(partial(self.media.line_rate, robot))
        )
        return answer_json(UplinkObject(streams, line_rate))

    async def stop(self, request: web.Request) -> web.Response:
        """Stop a robot: whoever may see it."""
        user, robot = await self._who_and_what(request, stops=True)
        self.control.stops.stop(
            robot,
            user.name,
            reason=await _reason(request),
            address=_address(request),
            press=press_of(request.query.get("press")),
        )
        await self.control.stops.confirmation(robot.id)
        return self._answer(robot)

    async def release(self, request: web.Request) -> web.Response:
        """Release a robot: a driver."""
        user, robot = await self._who_and_what(request)
        members = await _members(request)
        seen = schemas.read(members, ShownStop) if members else None
        self._check_level(user, robot, "drive", "release")
        stops = self.control.stops
        await stops.release(robot, user.name, seen=seen, address=_address(request))
        return self._answer(robot)

    async def lease(self, request: web.Request) -> web.Response:
        """Ask for the control, answer who asks, or take it."""
        user, robot = await self._who_and_what(request)
        body = schemas.read(await _members(request), LeaseAction)
        leasing = self.control.leasing
        actions: Mapping[str, Callable[[RelayRobot, LeaseRequester], None]] = {
            "ask": leasing.ask,
            "withdraw": leasing.withdraw,
            "hand_over": leasing.hand_over,
            "refuse": leasing.refuse,
            "take": leasing.take,
        }
        action = actions[body.action]
        if body.to is not UNSET:
            if body.action != "hand_over":
                raise FieldInvalidError(
                    "cannot use to: it is a user's name, and goes only with hand_over"
                )
            action = partial(leasing.hand_over, to=body.to)
        if body.driver is not UNSET:
            if body.action != "take":
                raise FieldInvalidError("cannot use driver: it goes only with take")
            action = partial(leasing.take, driver=body.driver)
        self._check_level(user, robot, "manage" if body.action == "take" else "drive", body.action)
        action(robot, LeaseRequester(user, _address(request)))
        return self._answer(robot)

    async def stop_many(self, request: web.Request) -> web.Response:
        """Stop all robots, or those of a site, that the caller manages."""
        user = (await self.access.for_change(request_of(request, stops=True))).user
        body = schemas.read(await _members(request, any_type=True), SiteStop)
        robots = [robot for robot in self._managed_robots(user) if body.site in {None, robot.site}]
        if not robots:
            where = "" if body.site is None else f" of site {body.site}"
            raise GrantMissingError(f"cannot stop all robots{where}: you manage none of them")
        stops, address = self.control.stops, _address(request)
        for robot in robots:
            stops.stop(robot, user.name, reason=body.reason, address=address)
        elsewhere = self.confirmation_elsewhere
        confirmed = await asyncio.gather(
            *(elsewhere(robot.id) or stops.confirmation(robot.id) for robot in robots)
        )
        results = [
            StoppedRobot(robot.name, robot.mac, stops.of(robot.id) is not None, is_confirmed)
            for robot, is_confirmed in zip(robots, confirmed, strict=True)
        ]
        return answer_json(StoppedRobotList(results, self.unreached()))

    async def _viewer_and_robot(self, request: web.Request) -> tuple[RelayUser, RelayRobot]:
        access_request = request_of(request)
        user = (await self.access.for_events(access_request)).user
        schemas.read_query(request.query.items(), RobotQuery)
        return user, self.access.visible_robot(user, request.match_info["name"], access_request)

    async def _who_and_what(
        self, request: web.Request, *, stops: bool = False
    ) -> tuple[RelayUser, RelayRobot]:
        access_request = request_of(request, stops=stops)
        user = (await self.access.for_change(access_request)).user
        if not stops:
            schemas.read_query(request.query.items(), RobotQuery)
        return user, self.access.visible_robot(user, request.match_info["name"], access_request)

    def _managed_robots(self, user: RelayUser) -> list[RelayRobot]:
        snapshot = self.snapshot()
        return [
            robot
            for robot in snapshot.visible(user.id)
            if robot.state == "active" and snapshot.level(user.id, robot.id) == "manage"
        ]

    def _check_level(self, user: RelayUser, robot: RelayRobot, needed: Level, action: str) -> None:
        level = self.snapshot().level(user.id, robot.id)
        if level is None or not includes(level, needed):
            raise GrantMissingError(
                f"cannot do {action!r} with robot {robot.name}: you need the right to {needed}"
            )

    def _answer(self, robot: RelayRobot) -> web.Response:
        return answer_json(self.control.describe(robot.id))


def answer_json(answer: Struct) -> web.Response:
    """Answer with what is true only now."""
    body = msgspec.json.encode(answer)
    return web.Response(
        body=body, content_type="application/json", charset="utf-8", headers=NO_STORE
    )


def _address(request: web.Request) -> str | None:
    return request.headers.get("X-Forwarded-For")


async def _reason(request: web.Request) -> str | None:
    """Return the reason for a stop; None where the body is none that can be read, which refuses no stop."""
    try:
        return schemas.read(await _members(request, any_type=True), StopReason).reason
    except (RobotetherError, web.HTTPRequestEntityTooLarge):
        return None


async def _members(request: web.Request, *, any_type: bool = False) -> Mapping[str, object]:
    """Read a body, which may be missing; with `any_type` also one that is sent as curl does without a type."""
    try:
        data = await request.read()
    except web.RequestPayloadError as exc:
        raise HttpError(400, "cannot read the body: it is cut off") from exc
    if not data:
        return {}
    if request.content_type != "application/json" and not any_type:
        raise HttpError(415, "cannot read the body: send it as application/json")
    try:
        members = json.loads(data)
    except (ValueError, RecursionError) as exc:
        raise HttpError(400, "cannot read the body: it is not JSON") from exc
    if not isinstance(members, dict):
        raise FieldInvalidError("cannot read the body: it must be an object")
    return members
