"""Routes between robots and web apps: who may make and remove them, and that they make no loop. The relay runs them."""

import datetime as dt
from collections.abc import Iterable
from dataclasses import dataclass

from robotether_common.ros import full_name

from robotether_server import schemas
from robotether_server.contract.ros import RosType
from robotether_server.db import Transaction, audit, routes, seen_robots
from robotether_server.db.audit import Source
from robotether_server.db.routes import NewRoute, Route
from robotether_server.db.users import User
from robotether_server.problems import (
    FieldInvalidError,
    GrantMissingError,
    NotPossibleError,
    RecordExistsError,
    RecordMissingError,
)
from robotether_server.schemas import AppName

# Rate of drive commands from a page, in Hz.
USUAL_RATE_HZ = 20.0
MIN_RATE_HZ, MAX_RATE_HZ = 0.1, 100.0
# Maximum number of routes per user, also of those that ended, so that nobody fills the relay.
MAX_ROUTES = 50
MAX_HOURS = 8760
LOCK, LOCK_WITHIN_S = "robotether routes", 5

# A robot's name, or an app's with its user's before it, and the full name of one of its topics.
Node = tuple[str, str]


@dataclass(frozen=True)
class RouteRequest:
    """A route that somebody asks for, by names; without `hours` it lasts until somebody removes it.

    `macs`: those of the robots that are meant.
    """

    source: str
    source_topic: str
    target: str
    target_topic: str
    type: str
    rate_hz: float = USUAL_RATE_HZ
    hours: int | None = None
    macs: tuple[str | None, ...] = (None, None)


def loop_with(edges: Iterable[tuple[Node, Node]], start: Node, end: Node) -> list[Node]:
    """Return the nodes that a further edge would go round, from its end back to it; empty: it closes no loop. Pure."""
    following: dict[Node, list[Node]] = {}
    for node, next_node in edges:
        following.setdefault(node, []).append(next_node)
    paths, seen = [[end]], {end}
    while paths:
        path = paths.pop()
        if path[-1] == start:
            return [*path, end]
        for node in following.get(path[-1], ()):
            if node not in seen:
                seen.add(node)
                paths.append([*path, node])
    return []


def list_seen(tx: Transaction, user: User) -> list[Route]:
    """Return the routes whose robots the user may see."""
    names = {seen.robot.name for seen in seen_robots.list_seen(tx, user)}
    return [route for route in routes.list_all(tx) if names.issuperset(_robots(route))]


def make(tx: Transaction, source: Source, user: User, route_request: RouteRequest) -> Route:
    """Make a route; its maker must manage its robots, and an app is that user's own.

    Raises FieldInvalidError, GrantMissingError, RobotUnknownError, RecordExistsError or NotPossibleError.
    """
    names, hours = (route_request.source, route_request.target), route_request.hours
    topics = (
        _topic("source_topic", route_request.source_topic),
        _topic("target_topic", route_request.target_topic),
    )
    schemas.check("type", route_request.type, RosType)
    if not MIN_RATE_HZ <= route_request.rate_hz <= MAX_RATE_HZ:
        raise FieldInvalidError(
            f"cannot use rate_hz: it must be {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}", "rate_hz"
        )
    if names[0] == names[1]:
        raise FieldInvalidError("cannot make the route: it must lead to another robot", "target")
    if all(map(routes.is_app, names)):
        raise FieldInvalidError("cannot make the route: one of its ends must be a robot", "target")
    macs = route_request.macs
    apps = [_app(*each) for each in zip(("source", "target"), names, macs, strict=True)]
    robot_ids = [
        seen_robots.require(tx, user, name, "manage", mac=mac).robot.id if app is None else None
        for name, app, mac in zip(names, apps, macs, strict=True)
    ]
    # Two that are made at once could close a loop that neither sees.
    if not tx.lock(LOCK, LOCK_WITHIN_S):
        raise NotPossibleError("cannot make the route: others are being made; try again shortly")
    start, end = (_node(user.name, *each) for each in zip(names, topics, strict=True))
    _check_among(tx, user, start, end)
    route_id = routes.add(
        tx,
        NewRoute(
            robot_ids[0],
            topics[0],
            robot_ids[1],
            topics[1],
            route_request.type,
            route_request.rate_hz,
            user.id,
            None if hours is None else tx.now() + dt.timedelta(hours=hours),
            *apps,
        ),
    )
    route = routes.get(tx, route_id)
    audit.record(tx, source, "route_made", _audited(route), **_details(route))
    return route


def remove(tx: Transaction, source: Source, user: User, route_id: int) -> Route:
    """Remove a route, also one that has ended: for its maker, and managers of one of its robots.

    Raises RecordMissingError or GrantMissingError.
    """
    route = routes.get(tx, route_id)
    ends = [seen_robots.find_seen(tx, user, name) for name in _robots(route)]
    levels = [seen.level for seen in ends if seen is not None]
    if len(levels) < len(ends) and route.made_by != user.name:
        raise RecordMissingError(f"cannot find route {route_id}: there is none of that number")
    if route.made_by != user.name and "manage" not in levels:
        raise GrantMissingError(
            f"cannot remove route {route_id}: it is {route.made_by}'s, and you manage none of its robots"
        )
    routes.remove(tx, route_id)
    audit.record(tx, source, "route_removed", _audited(route), **_details(route))
    return route


def _check_among(tx: Transaction, user: User, start: Node, end: Node) -> None:
    """Raise the problem of a route beside those that last, or make room for it."""
    present = routes.list_all(tx)
    lasting = [route for route in present if route.ended_at is None]
    edges = [(_start(route), _end(route)) for route in lasting]
    if (start, end) in edges:
        raise RecordExistsError("cannot make the route: there is one from this topic to that")
    if loop := loop_with(edges, start, end):
        path = _path_words(tx, user, loop)
        raise NotPossibleError(f"cannot make the route: it would close a loop of {path}")
    own = [route for route in present if route.made_by == user.name]
    if sum(route.ended_at is None for route in own) >= MAX_ROUTES:
        raise NotPossibleError(f"cannot make the route: you have {MAX_ROUTES}; remove one")
    # Those that ended first, which the user may no longer see.
    for route in own[MAX_ROUTES - 1 :]:
        routes.remove(tx, route.id)


def _path_words(tx: Transaction, user: User, path: Iterable[Node]) -> str:
    """Write the topics of a path; of what the user may not see it says no more than that it is there."""
    names = {seen.robot.name for seen in seen_robots.list_seen(tx, user)}
    return ", ".join(
        f"{end} {topic}"
        if end in names or end.startswith(f"{user.name}/")
        else "a robot or app that you may not see"
        for end, topic in path
    )


def _start(route: Route) -> Node:
    return _node(route.made_by, route.source, route.source_topic)


def _end(route: Route) -> Node:
    return _node(route.made_by, route.target, route.target_topic)


def _node(user: str, end: str, topic: str) -> Node:
    """Name a topic of an end; apps of two users with one name are two."""
    return f"{user}/{end}" if routes.is_app(end) else end, topic


def _robots(route: Route) -> list[str]:
    return [end for end in (route.source, route.target) if not routes.is_app(end)]


def _audited(route: Route) -> str:
    return routes.audited_robot(route.source, route.target)


def _app(field: str, end: str, mac: str | None) -> str | None:
    """Return the name of the app that an end is; None: it is a robot."""
    if not routes.is_app(end):
        return None
    if mac is not None:
        raise FieldInvalidError(f"cannot use {field}_mac: an app has none", f"{field}_mac")
    name = end.removeprefix(schemas.APP)
    schemas.check(field, name, AppName)
    return name


def _topic(field: str, name: str) -> str:
    topic = full_name(name)
    if topic is None:
        raise FieldInvalidError(
            f"cannot use {field}: it must be a topic's full name such as /a/b_1", field
        )
    return topic


def _details(route: Route) -> dict[str, object]:
    return {
        "route": route.id,
        "source": route.source,
        **({"target": route.target} if routes.is_app(route.target) else {}),
        "source_topic": route.source_topic,
        "target_topic": route.target_topic,
        "maker": route.made_by,
    }
