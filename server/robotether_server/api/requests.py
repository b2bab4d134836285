"""/api/v1/requests: robots that need a person. /api/v1/queue/me: the caller as an operator, to whom they are offered.

/api/v1/operators: who answers, for managers of robots. /api/v1/users/NAME/pools: for which requests a user is asked.
"""

from typing import Annotated, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server import schemas
from robotether_server.api.auth import Caller
from robotether_server.api.exports import RobotMac
from robotether_server.api.operations import operation
from robotether_server.db import requests, seen_robots
from robotether_server.db.requests import Figures, HelpRequest, Priority, RequestPeriod
from robotether_server.identity import normalise_mac
from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import NewPlainName, PlainName, RobotName, UserName
from robotether_server.services import operators
from robotether_server.services import requests as request_service
from robotether_server.services.operators import Choice, QueueView, SeenOperator
from robotether_server.services.requests import PeriodLength

MAX_REASON, MAX_NOTE, MAX_POOLS = 200, 500, 20
MAX_HOURS = 24 * 366


def _read_pool(value: object, path: str) -> str:
    """Return the name of a pool, or the empty text, which is any."""
    return "" if value == "" else str(schemas.value(path, value, NewPlainName))


def _read_note(value: object, path: str) -> str:
    """Return a text on one line, which may be empty."""
    note = " ".join(value.split()) if isinstance(value, str) else None
    if note is None or len(note) > MAX_NOTE or not note.isprintable():
        raise FieldInvalidError(
            f"cannot use {path}: it must be a text of at most {MAX_NOTE} printable characters", path
        )
    return note


Pool = Annotated[
    str,
    Meta(
        description="The pool of operators who are asked; empty: all",
        extra_json_schema={"pattern": "^([a-z0-9][a-z0-9._-]{0,62})?$"},
        extra={"read": _read_pool},
    ),
]
Note = Annotated[str, Meta(extra_json_schema={"maxLength": MAX_NOTE}, extra={"read": _read_note})]


class NewHelpRequest(Struct, forbid_unknown_fields=True):
    """A request for help."""

    reason: Annotated[str, Meta(min_length=1, max_length=MAX_REASON)]
    priority: Priority = 2
    pool: Pool = ""


class RequestQuery(Struct, forbid_unknown_fields=True):
    """Which requests to list; `closed` has those that were cancelled, too."""

    state: Literal["open", "closed"] = "open"
    robot: RobotName | UnsetType = UNSET
    mac: RobotMac | UnsetType = UNSET


class HelpRequestList(Struct):
    """Open requests, the most urgent first, then the oldest; closed ones, the newest first, at most 100."""

    requests: list[HelpRequest]


class Heartbeat(Struct, forbid_unknown_fields=True):
    """That the operator is there; `state` is what the operator chose now, and may be left out."""

    state: Choice | UnsetType = UNSET


class AcceptedRequest(Struct):
    """An accepted request, and the page where its robot is driven."""

    request: HelpRequest
    drive_url: str


class ClosingNote(Struct, forbid_unknown_fields=True):
    """What the operator writes at the end."""

    note: Note = ""


class Assignment(Struct, forbid_unknown_fields=True):
    """Whom a request is offered to."""

    user: UserName


class OperatorList(Struct):
    """Operators, by name."""

    operators: list[SeenOperator]


class UserPools(Struct, forbid_unknown_fields=True):
    """The pools of a user."""

    pools: Annotated[list[NewPlainName], Meta(max_length=MAX_POOLS)]


class UserPoolList(Struct):
    """The pools of a user, by name."""

    pools: list[PlainName]


class FiguresQuery(Struct, forbid_unknown_fields=True):
    """The time of the figures."""

    hours: Annotated[int, Meta(ge=1, le=MAX_HOURS)] = 24


class PeriodsQuery(Struct, forbid_unknown_fields=True):
    """The length of a period."""

    by: PeriodLength = "hour"


class RequestPeriodList(Struct):
    """The last 24 hours or 30 days, the oldest first; the last is not over."""

    periods: list[RequestPeriod]


@operation("POST", "/robots/<robot>/requests", "user", tag="requests", problems=(409,))
def ask_for_help(
    caller: Caller, robot: str, body: NewHelpRequest
) -> tuple[HelpRequest, Literal[200, 201]]:
    """Ask for help with a robot.

    It takes the right to drive the robot. If a request of this kind is open already, that one is answered (200), with
    its own reason and pool, and the more urgent priority of the two. A robot has at most 4 open requests.
    """
    request, is_new = request_service.make(
        caller.tx,
        caller.source,
        caller.user,
        robot,
        reason=body.reason,
        priority=body.priority,
        pool=body.pool,
    )
    return request, 201 if is_new else 200


@operation("GET", "/requests", "user", tag="requests", renews_login=False, problems=(404,))
def list_requests(caller: Caller, query: RequestQuery) -> HelpRequestList:
    """List requests of the robots that the caller may see."""
    mac = None if query.mac is UNSET else normalise_mac(query.mac)
    if query.robot:
        to = "list requests of"
        seen_robots.require(caller.tx, caller.user, query.robot, "observe", to, mac=mac)
    find = requests.list_open if query.state == "open" else requests.list_closed
    found_requests = find(caller.tx, caller.user.id, query.robot or None, mac)
    return HelpRequestList([seen.request for seen in found_requests])


@operation("GET", "/requests/figures", "user", tag="requests", renews_login=False)
def show_request_figures(caller: Caller, query: FiguresQuery) -> Figures:
    """Get how long requests waited that were accepted in the last hours, and what is open.

    Of the robots that the caller may see. What is not known is null.
    """
    return request_service.read_figures(caller.tx, caller.user, query.hours)


@operation("GET", "/requests/periods", "user", tag="requests", renews_login=False)
def list_request_periods(caller: Caller, query: PeriodsQuery) -> RequestPeriodList:
    """List how many requests were made, closed and cancelled in each hour or day of UTC, and how long they waited.

    Of the robots that the caller may see. What is not known is null.
    """
    return RequestPeriodList(request_service.read_periods(caller.tx, caller.user, query.by))


@operation("POST", "/requests/<int:request_id>/accept", "user", tag="requests", problems=(409,))
def accept_request(caller: Caller, request_id: int) -> AcceptedRequest:
    """Accept the request that is offered to the caller."""
    request = request_service.accept(caller.tx, caller.source, caller.user, request_id)
    return AcceptedRequest(request, f"/robots/{request.robot}")


@operation("POST", "/requests/<int:request_id>/decline", "user", tag="requests", problems=(409,))
def decline_request(caller: Caller, request_id: int) -> HelpRequest:
    """Pass the request that is offered to the caller on to the next operator."""
    return request_service.decline(caller.tx, caller.source, caller.user, request_id)


@operation("POST", "/requests/<int:request_id>/assign", "user", tag="requests", problems=(409,))
def assign_request(caller: Caller, request_id: int, body: Assignment) -> HelpRequest:
    """Offer an open request to an operator who is available, in place of whoever has it.

    For managers of the robot. It ends the operator's time to wrap up.
    """
    return request_service.assign(caller.tx, caller.source, caller.user, request_id, body.user)


@operation("POST", "/requests/<int:request_id>/close", "user", tag="requests", problems=(409,))
def close_request(caller: Caller, request_id: int, body: ClosingNote) -> HelpRequest:
    """Close an accepted request; for whoever accepted it, and managers of the robot."""
    return request_service.close(caller.tx, caller.source, caller.user, request_id, body.note)


@operation("POST", "/requests/<int:request_id>/cancel", "user", tag="requests", problems=(409,))
def cancel_request(caller: Caller, request_id: int) -> HelpRequest:
    """Cancel an open request; for whoever asked, and managers of the robot."""
    return request_service.cancel(caller.tx, caller.source, caller.user, request_id)


@operation("PUT", "/queue/me", "user", tag="requests", renews_login=False)
def poll_queue(caller: Caller, body: Heartbeat) -> QueueView:
    """Send a heartbeat as an operator, and get the offer to answer.

    Once a second. After 10 s without one the caller is away, until `state` says `available` again.
    """
    return operators.poll(caller.tx, caller.user, body.state or None)


@operation("GET", "/operators", "user", tag="requests", problems=(403,), renews_login=False)
def list_operators(caller: Caller) -> OperatorList:
    """List who has opened the queue and may drive a robot that the caller manages, and what they do."""
    return OperatorList(operators.list_operators(caller.tx, caller.user))


@operation("GET", "/users/<user>/pools", "admin")
def list_user_pools(caller: Caller, user: str) -> UserPoolList:
    """List the pools of a user."""
    return UserPoolList(request_service.read_pools(caller.tx, user))


@operation("PUT", "/users/<user>/pools", "admin")
def set_user_pools(caller: Caller, user: str, body: UserPools) -> UserPoolList:
    """Replace the pools of a user, who is then offered the requests of these pools and of none."""
    pools = request_service.set_pools(caller.tx, caller.source, user, list(body.pools))
    return UserPoolList(pools)
