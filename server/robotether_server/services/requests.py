"""Requests for help: people make, accept, decline, assign, close and cancel them.

Each changes a request under the lock of `requests`, so that none is given to two. What an operator has accepted never
closes by itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from robotether_server import schemas
from robotether_server.db import Transaction, audit, operators, requests, seen_robots, users
from robotether_server.db.audit import Source
from robotether_server.db.grants import includes
from robotether_server.db.requests import (
    Figures,
    HelpRequest,
    NewRequest,
    RequestPeriod,
    SeenRequest,
)
from robotether_server.db.users import User
from robotether_server.problems import GrantMissingError, NotPossibleError
from robotether_server.schemas import NewPlainName
from robotether_server.services.operators import state_of
from robotether_server.services.planning import OFFER_S, WRAP_UP_S

PeriodLength = Literal["hour", "day"]
# The length of a period in seconds, and how many the figures over time have.
PERIODS: Mapping[PeriodLength, tuple[int, int]] = {"hour": (3600, 24), "day": (86_400, 30)}


def make(
    tx: Transaction,
    source: Source,
    user: User,
    robot: str,
    *,
    reason: str,
    priority: int,
    pool: str,
) -> tuple[HelpRequest, bool]:
    """Ask for help with a robot; return the request, and whether it is new: another may be open already.

    Raises RobotUnknownError, GrantMissingError or NotPossibleError.
    """
    seen = seen_robots.require(tx, user, robot, "drive", "ask for help with")
    request = NewRequest(
        robot_id=seen.robot.id,
        reason=reason,
        source="page" if source.api_token is None else "api",
        priority=priority,
        pool=pool,
        asked_by=user.name,
        address=source.address,
    )
    request_id, is_new = requests.add(tx, request)
    if request_id is None:
        raise NotPossibleError(
            f"cannot ask for help with robot {robot}: it is disabled, or has as many open requests as it may"
        )
    return requests.get(tx, user.id, request_id).request, is_new


def accept(tx: Transaction, source: Source, user: User, request_id: int) -> HelpRequest:
    """Accept an offer; raise NotPossibleError if it is another's or over, or GrantMissingError.

    The operator who has accepted it may repeat that.
    """
    seen = _lock(tx, user, request_id)
    if seen.request.state == "accepted" and seen.accepted_by_id == user.id:
        return seen.request
    if not includes(seen.level, "drive"):
        raise GrantMissingError(
            f"cannot accept request {request_id}: you need the right to drive robot {seen.request.robot}"
        )
    operator = operators.find(tx, user.id)
    if operator is not None and operator.accepted_at is not None:
        raise NotPossibleError(
            f"cannot accept request {request_id}: you have another one; close that first"
        )
    if not requests.accept(tx, request_id, user.id):
        raise NotPossibleError(
            f"cannot accept request {request_id}: it is not offered to you, or no longer"
        )
    return _noted(tx, source, user, "request_accepted", request_id)


def decline(tx: Transaction, source: Source, user: User, request_id: int) -> HelpRequest:
    """Pass an offer on to the next operator; raise NotPossibleError if it is not the user's."""
    seen = _lock(tx, user, request_id)
    if seen.request.state != "offered" or seen.request.offered_to != user.name:
        raise NotPossibleError(
            f"cannot decline request {request_id}: it is not offered to you, or no longer"
        )
    requests.wait_again(tx, request_id, passed_by=user.id)
    return _noted(tx, source, user, "request_declined", request_id)


def assign(tx: Transaction, source: Source, user: User, request_id: int, name: str) -> HelpRequest:
    """Offer a request to an operator by hand, in place of whoever has it.

    Raises GrantMissingError, or NotPossibleError if that operator cannot take it now.
    """
    seen = _lock(tx, user, request_id)
    _check_managed(seen, "assign")
    _check_open(seen, "assign")
    target = users.find(tx, name)
    rights = {} if target is None else operators.read_rights(tx, [target.id], [seen.robot_id])
    if target is None or not rights[target.id]:
        raise NotPossibleError(
            f"cannot assign request {request_id}: no user {name} may drive robot {seen.request.robot}"
        )
    _check_nobody_else_helps(tx, seen)
    _end_other_offer(tx, source, seen, target)
    requests.offer(tx, request_id, target.id, OFFER_S)
    operators.set_wrap_up(tx, target.id, 0)
    state = state_of(operators.find(tx, target.id))
    if state != "available":
        raise NotPossibleError(f"cannot assign request {request_id}: user {name} is {state}")
    return _noted(tx, source, user, "request_assigned", request_id, user=name)


def close(
    tx: Transaction, source: Source, user: User, request_id: int, note: str = ""
) -> HelpRequest:
    """Close an accepted request, and begin its operator's time to wrap up.

    Raises GrantMissingError or NotPossibleError.
    """
    seen = _lock(tx, user, request_id)
    if seen.request.state != "accepted":
        raise NotPossibleError(
            f"cannot close request {request_id}: it is {seen.request.state}, not accepted"
        )
    if seen.accepted_by_id != user.id:
        _check_managed(seen, "close")
    _end(tx, seen, "closed", note or None)
    return _noted(tx, source, user, "request_closed", request_id, note=note)


def cancel(tx: Transaction, source: Source, user: User, request_id: int) -> HelpRequest:
    """Cancel a request: for whoever asked, and managers. Raises GrantMissingError or NotPossibleError."""
    seen = _lock(tx, user, request_id)
    _check_open(seen, "cancel")
    if not seen.is_own:
        _check_managed(seen, "cancel")
    _end(tx, seen, "cancelled")
    return _noted(tx, source, user, "request_cancelled", request_id)


def read_figures(tx: Transaction, user: User, hours: int) -> Figures:
    """Return the figures of the robots that the user may see."""
    waits = requests.read_waits(tx, user.id, hours)
    ages = [seen.request.age_s for seen in requests.list_open(tx, user.id)]
    return Figures(
        waiting_p50_s=_quantile(waits, 0.5),
        waiting_p95_s=_quantile(waits, 0.95),
        answered=len(waits),
        open=len(ages),
        oldest_open_s=max(ages, default=None),
    )


def read_periods(tx: Transaction, user: User, by: PeriodLength) -> list[RequestPeriod]:
    """Return the figures over time of the robots that the user may see."""
    return requests.read_periods(tx, user.id, *PERIODS[by])


def set_pools(tx: Transaction, source: Source, name: str, pools: list[str]) -> list[str]:
    """Replace the pools of a user; return them by name. Raises FieldInvalidError or RecordMissingError."""
    for pool in pools:
        schemas.check("pools", pool, NewPlainName)
    user = users.get(tx, name)
    was, new = read_pools(tx, name), sorted(set(pools))
    if was != new:
        operators.set_pools(tx, user.id, new)
        audit.record(tx, source, "user_pools_set", user=name, was=was, pools=new)
    return new


def read_pools(tx: Transaction, name: str) -> list[str]:
    """Return the pools of a user, by name; raise RecordMissingError."""
    return operators.read_pools(tx).get(users.get(tx, name).id, [])


def _lock(tx: Transaction, user: User, request_id: int) -> SeenRequest:
    """Return a request that stays as it is until the transaction ends; raise RecordMissingError."""
    requests.lock(tx)
    return requests.get(tx, user.id, request_id)


def _check_managed(seen: SeenRequest, action: str) -> None:
    if seen.level != "manage":
        raise GrantMissingError(
            f"cannot {action} request {seen.request.id}: you need the right to manage robot {seen.request.robot}"
        )


def _check_open(seen: SeenRequest, action: str) -> None:
    if not seen.request.is_open:
        raise NotPossibleError(
            f"cannot {action} request {seen.request.id}: it is {seen.request.state}"
        )


def _end_other_offer(tx: Transaction, source: Source, seen: SeenRequest, target: User) -> None:
    """Let another request wait again that is offered to a user who gets this one; it counts as no pass."""
    for other in requests.read_open(tx):
        if other.offered_to == target.id and other.id != seen.request.id:
            requests.wait_again(tx, other.id)
            audit.record(
                tx,
                source,
                "request_passed",
                other.robot,
                request=other.id,
                user=target.name,
                why="assigned_another",
            )


def _check_nobody_else_helps(tx: Transaction, seen: SeenRequest) -> None:
    """Raise NotPossibleError if another request of the robot is with an operator: two would reserve its lease."""
    for other in requests.read_open(tx):
        if (
            other.robot_id == seen.robot_id
            and other.id != seen.request.id
            and other.state != "waiting"
        ):
            raise NotPossibleError(
                f"cannot assign request {seen.request.id}: request {other.id} of robot {other.robot} "
                f"is {other.state}; wait for its end"
            )


def _end(
    tx: Transaction,
    seen: SeenRequest,
    state: Literal["closed", "cancelled"],
    note: str | None = None,
) -> None:
    requests.end(tx, seen.request.id, state, note)
    if seen.accepted_by_id is not None:
        operators.set_wrap_up(tx, seen.accepted_by_id, WRAP_UP_S)


def _noted(
    tx: Transaction, source: Source, viewer: User, kind: str, request_id: int, **details: str
) -> HelpRequest:
    """Write what happened to the request into the audit log; return the request as it is now."""
    request = requests.get(tx, viewer.id, request_id).request
    audit.record(tx, source, kind, request.robot, request=request_id, **details)
    return request


def _quantile(values: list[float], share: float) -> float | None:
    """Return the smallest of these sorted values that this share of them does not exceed; None: there are none."""
    return values[max(math.ceil(len(values) * share) - 1, 0)] if values else None
