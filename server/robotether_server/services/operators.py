"""The queue of operators: their heartbeats, each of which may plan, and what each operator sees.

There is no planner elsewhere: whoever asks first after PLAN_EVERY_S plans for all, under the lock of
`requests`. Where nobody asks, there is nobody to offer anything to.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from robotether_server.db import Transaction, audit, operators, requests
from robotether_server.db.audit import Source
from robotether_server.db.grants import includes
from robotether_server.db.operators import OperatorRow
from robotether_server.db.requests import HelpRequest, OpenRequest, SeenRequest
from robotether_server.db.users import User
from robotether_server.problems import GrantMissingError, StoreUnavailableError
from robotether_server.schemas import Amount, Count, Timestamp, UserName
from robotether_server.services import planning
from robotether_server.services.planning import (
    AWAY_AFTER_S,
    OFFER_S,
    PLAN_EVERY_S,
    WRAP_UP_S,
    Offer,
    Operator,
    OperatorState,
    QueueState,
    WaitingRequest,
)

Choice = Literal["available", "away"]
PLANNER = Source("planner")
# Maximum number of waiting requests in an operator's view.
MAX_WAITING = 50


@dataclass(frozen=True)
class QueueView:
    """What an operator sees: the offer to answer, the request that the operator has, and what waits.

    `available` is what the operator chose, which holds again after `busy`. `waiting` has what the operator may be
    offered, the most urgent MAX_WAITING of `waiting_count`. `ahead` is the number of available operators who are
    offered a request first; null: the operator is not available.
    """

    state: OperatorState
    available: bool
    offer: HelpRequest | None
    offer_left_s: Amount | None
    current: HelpRequest | None
    wrap_up_left_s: Amount | None
    waiting: list[HelpRequest]
    waiting_count: Count
    ahead: Count | None


@dataclass(frozen=True)
class Staff:
    """The operators with a heartbeat in the last AWAY_AFTER_S, and the pools of each user who has any."""

    rows: list[OperatorRow]
    pools: dict[int, list[str]]


@dataclass(frozen=True)
class SeenOperator:
    """An operator as a manager sees one; `request` is the one that the operator has or is offered."""

    user: UserName
    state: OperatorState
    since: Timestamp
    request: HelpRequest | None
    pools: list[str]


def state_of(row: OperatorRow | None) -> OperatorState:
    """Return what an operator does now."""
    if row is None:
        return "away"
    if row.busy_since is not None:
        return "busy"
    if not row.available or row.unseen_s > AWAY_AFTER_S:
        return "away"
    return "wrap_up" if _wrap_up_left_s(row) else "available"


def _wrap_up_left_s(row: OperatorRow) -> float:
    """Return the time that is left to wrap up, in seconds; none of an end that a clock which was set back has moved."""
    return row.wrap_up_left_s if row.wrap_up_left_s <= WRAP_UP_S else 0.0


def poll(tx: Transaction, user: User, choice: Choice | None) -> QueueView:
    """Take a heartbeat of an operator, plan if that is due, and return what the operator sees.

    Without a choice an operator stays what it was; but an operator who was gone for too long is away until they choose,
    unless they drove or have a request. So is one who let an offer end. Who is back is asked as if for the first time.
    """
    row = operators.find(tx, user.id)
    was_there = row is not None and row.available
    if row is not None and row.unseen_s > AWAY_AFTER_S:
        was_there = was_there and row.busy_since is not None
    available = was_there if choice is None else choice == "available"
    stays_away = not available and row is not None and not row.available
    is_idle = state_of(row) == "available" or (state_of(row) == "away" and stays_away)
    operators.write_heartbeat(tx, user.id, available=available, is_idle=is_idle)
    if available and not was_there:
        requests.forget_passes(tx, user.id)
    staff = plan_if_due(tx) or _read_staff(tx)
    return _view(tx, user, staff)


def _read_staff(tx: Transaction) -> Staff:
    return Staff(operators.list_seen_within(tx, AWAY_AFTER_S), operators.read_pools(tx))


def plan_if_due(tx: Transaction) -> Staff | None:
    """Offer waiting requests to operators, unless somebody does or has just done so; return whom it looked at."""
    now = requests.lock_to_plan(tx, PLAN_EVERY_S)
    if now is None:
        return None
    open_requests = requests.read_open(tx)
    if not open_requests:
        return None
    requests.set_planned(tx, now)
    _send_away(tx, open_requests, now)
    staff = _read_staff(tx)
    holders = {request.accepted_by for request in open_requests if request.accepted_by is not None}
    rights = operators.read_rights(
        tx,
        holders | {row.user_id for row in staff.rows},
        {request.robot_id for request in open_requests},
    )
    _release_lost(tx, open_requests, rights)
    plan = _plan(tx, now, open_requests, staff, rights)
    _carry_out(tx, open_requests, plan, {row.user_id: row.user for row in staff.rows}, rights)
    return staff


def _send_away(tx: Transaction, open_requests: list[OpenRequest], now: dt.datetime) -> None:
    """Let operators be away who let an offer end: nobody sits there, and the next request must not wait for them."""
    for request in open_requests:
        if request.offered_to and request.offer_until and request.offer_until <= now:
            operators.set_away(tx, request.offered_to)


def _release_lost(
    tx: Transaction, open_requests: list[OpenRequest], rights: Mapping[int, frozenset[int]]
) -> None:
    """Let requests wait again whose user is gone, or has lost the right to drive the robot."""
    for request in open_requests:
        user_id = request.offered_to if request.state == "offered" else request.accepted_by
        is_lost = request.state != "waiting" and user_id is None
        if request.state == "accepted" and user_id is not None:
            is_lost = request.robot_id not in rights[user_id]
        if is_lost:
            requests.wait_again(tx, request.id)
            _note_pass(tx, request, why="right_ended")


def _plan(
    tx: Transaction,
    now: dt.datetime,
    open_requests: list[OpenRequest],
    staff: Staff,
    rights: Mapping[int, frozenset[int]],
) -> planning.Plan:
    unanswered = _unanswered(open_requests)
    passes = requests.read_passes(tx, [request.id for request in unanswered])
    return planning.plan(
        QueueState(
            now=now.timestamp(),
            waiting=tuple(
                WaitingRequest(
                    request.id,
                    request.robot_id,
                    request.priority,
                    request.pool,
                    request.created_at.timestamp(),
                    _seconds(passes.get(request.id, {})),
                )
                for request in unanswered
            ),
            offers=tuple(
                Offer(request.id, request.offered_to, request.offer_until.timestamp())
                for request in open_requests
                if request.offered_to is not None and request.offer_until is not None
            ),
            operators=tuple(
                Operator(
                    row.user_id,
                    state_of(row),
                    row.idle_since.timestamp(),
                    frozenset(staff.pools.get(row.user_id, ())),
                    rights[row.user_id],
                )
                for row in staff.rows
            ),
        )
    )


def _unanswered(open_requests: list[OpenRequest]) -> list[OpenRequest]:
    """Return what may be or stay offered: one request of each robot, and none where somebody is at work."""
    by_robot: dict[int, OpenRequest] = {}
    # Stable: those of a state stay in the order of urgency.
    for request in sorted(
        open_requests, key=lambda request: ("accepted", "offered", "waiting").index(request.state)
    ):
        by_robot.setdefault(request.robot_id, request)
    return [
        request
        for request in by_robot.values()
        if request.state != "accepted" and request.robot_state == "active"
    ]


def _seconds(passes: Mapping[int, dt.datetime]) -> dict[int, float]:
    return {user_id: passed_at.timestamp() for user_id, passed_at in passes.items()}


def _carry_out(
    tx: Transaction,
    open_requests: list[OpenRequest],
    plan: planning.Plan,
    names: Mapping[int, str],
    rights: Mapping[int, frozenset[int]],
) -> None:
    by_id = {request.id: request for request in open_requests}
    for offer in plan.end:
        request = by_id[offer.request_id]
        requests.wait_again(tx, offer.request_id, passed_by=offer.user_id)
        is_lost = offer.user_id in rights and request.robot_id not in rights[offer.user_id]
        _note_pass(tx, request, why="right_ended" if is_lost else "no_answer")
    for offer in plan.offer:
        requests.offer(tx, offer.request_id, offer.user_id, OFFER_S)
        request, user = by_id[offer.request_id], names[offer.user_id]
        audit.record(tx, PLANNER, "request_offered", request.robot, request=request.id, user=user)


def _note_pass(tx: Transaction, request: OpenRequest, *, why: str) -> None:
    source = PLANNER if request.user is None else Source(request.user)
    audit.record(tx, source, "request_passed", request.robot, request=request.id, why=why)


def _view(tx: Transaction, user: User, staff: Staff) -> QueueView:
    row = next((row for row in staff.rows if row.user_id == user.id), None)
    if row is None:
        raise StoreUnavailableError(
            "cannot show the queue: the database was too slow; try again shortly"
        )
    state = state_of(row)
    open_requests = requests.list_open(tx, user.id)
    offer = _first(open_requests, "offered", user)
    waiting = _waiting(open_requests, staff.pools.get(user.id, []))
    return QueueView(
        state=state,
        available=row.available,
        offer=offer,
        offer_left_s=_left_s(offer, row.now),
        current=_first(open_requests, "accepted", user),
        wrap_up_left_s=_wrap_up_left_s(row) if state == "wrap_up" else None,
        waiting=waiting[:MAX_WAITING],
        waiting_count=len(waiting),
        ahead=_ahead(tx, row, staff, open_requests) if state == "available" else None,
    )


def _first(
    open_requests: list[SeenRequest], state: Literal["offered", "accepted"], user: User
) -> HelpRequest | None:
    for seen in open_requests:
        request = seen.request
        if request.state == state and user.name in (request.offered_to, request.accepted_by):
            return request
    return None


def _left_s(offer: HelpRequest | None, now: dt.datetime) -> float | None:
    if offer is None or offer.offer_until is None:
        return None
    # An offer of this plan began after `now`.
    return min(max((offer.offer_until - now).total_seconds(), 0.0), OFFER_S)


def _waiting(open_requests: list[SeenRequest], pools: list[str]) -> list[HelpRequest]:
    return [
        seen.request
        for seen in open_requests
        if seen.request.state == "waiting"
        and includes(seen.level, "drive")
        and seen.request.pool in ("", *pools)
    ]


def _ahead(
    tx: Transaction, row: OperatorRow, staff: Staff, open_requests: list[SeenRequest]
) -> int:
    """Count the available operators without an offer, as far as this user sees, whom the plan asks before.

    Of those alone who may drive a robot that this user may drive: the others are asked for other requests.
    """

    def turn(operator: OperatorRow) -> tuple[int, dt.datetime, int]:
        return len(staff.pools.get(operator.user_id, ())), operator.idle_since, operator.user_id

    offered = {seen.request.offered_to for seen in open_requests}
    earlier = [
        other.user_id
        for other in staff.rows
        if state_of(other) == "available" and other.user not in offered and turn(other) < turn(row)
    ]
    return operators.count_sharing(tx, row.user_id, earlier)


def list_operators(tx: Transaction, user: User) -> list[SeenOperator]:
    """Return the operators who may drive a robot that the user manages; raise GrantMissingError if that is none."""
    managed = operators.list_managed(tx, user.id)
    if not managed:
        raise GrantMissingError("cannot list operators: it is for those who manage a robot")
    rows = operators.list_all(tx)
    rights = operators.read_rights(tx, [row.user_id for row in rows], managed)
    pools = operators.read_pools(tx)
    by_user: dict[str | None, HelpRequest] = {}
    for seen in requests.list_open(tx, user.id):
        by_user[seen.request.accepted_by or seen.request.offered_to] = seen.request
    return [
        SeenOperator(
            row.user,
            state_of(row),
            _since(row),
            by_user.get(row.user),
            pools.get(row.user_id, []),
        )
        for row in rows
        if rights[row.user_id]
    ]


def _since(row: OperatorRow) -> dt.datetime:
    match state_of(row):
        case "busy":
            return row.busy_since or row.now
        case "away":
            return row.last_seen_at if row.available else row.idle_since
        case "wrap_up" if row.wrap_up_until is not None:
            return row.wrap_up_until - dt.timedelta(seconds=WRAP_UP_S)
        case _:
            return row.idle_since
