"""/api/v1/routes: routes between robots and web apps, made and removed by managers. The relay shows them live."""

from typing import Annotated

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server.api.auth import Caller
from robotether_server.api.operations import Created, operation
from robotether_server.contract.ros import RosType
from robotether_server.db.routes import Route
from robotether_server.schemas import Mac, RouteEndName
from robotether_server.services import routes as route_service
from robotether_server.services.routes import MAX_HOURS, MAX_RATE_HZ, MIN_RATE_HZ, RouteRequest

Topic = Annotated[
    str, Meta(min_length=1, max_length=255, extra_json_schema={"examples": ["/cmd_vel"]})
]


class GivenRoute(Struct, forbid_unknown_fields=True):
    """A new route. `type`: of both topics. Without `hours` it lasts until somebody removes it.

    `source_mac`, `target_mac`: those of the robots meant, as others may have their names by now.
    """

    source: RouteEndName
    source_topic: Topic
    target: RouteEndName
    target_topic: Topic
    type: RosType
    rate_hz: (
        Annotated[
            float,
            Meta(
                ge=MIN_RATE_HZ,
                le=MAX_RATE_HZ,
                description="Maximum rate; the newest message goes, others are left out",
            ),
        ]
        | UnsetType
    ) = UNSET
    hours: Annotated[int, Meta(ge=1, le=MAX_HOURS)] | UnsetType = UNSET
    source_mac: Mac | UnsetType = UNSET
    target_mac: Mac | UnsetType = UNSET


class RouteList(Struct):
    """Routes, those that last first, then those that ended; the newest first."""

    routes: list[Route]


@operation("GET", "/routes", "user")
def list_routes(caller: Caller) -> RouteList:
    """List the routes whose robots the caller may see."""
    return RouteList(route_service.list_seen(caller.tx, caller.user))


@operation("POST", "/routes", "user", problems=(404, 409))
def make_route(caller: Caller, body: GivenRoute) -> Created[Route]:
    """Make a route from a topic of one robot, or of an app of the caller's, to one of another; level manage on robots.

    A route drives its target as a driver does, with the lease. It ends for good when the target is stopped or anybody
    else drives it, and within 2 s when its maker's right ends. 409 not_possible: it would close a loop.
    """
    route_request = RouteRequest(
        body.source,
        body.source_topic,
        body.target,
        body.target_topic,
        body.type,
        body.rate_hz or route_service.USUAL_RATE_HZ,
        body.hours or None,
        tuple(None if mac is UNSET else mac for mac in (body.source_mac, body.target_mac)),
    )
    return route_service.make(caller.tx, caller.source, caller.user, route_request), 201


@operation("DELETE", "/routes/<int:route_id>", "user", problems=(403,))
def remove_route(caller: Caller, route_id: int) -> None:
    """Remove a route: its maker, or who manages one of its robots."""
    route_service.remove(caller.tx, caller.source, caller.user, route_id)
