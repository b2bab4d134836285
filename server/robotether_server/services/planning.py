"""Which waiting request for help is offered to which operator next. Pure: no clock, no database.

`services/requests` calls it under the row lock of `planner`, and writes what it decides. All times are
seconds of one clock, the database's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

# Time limit for the answer to an offer.
OFFER_S = 20.0
# Time limit of an offer by a clock that may have been set back a little; one that would last for longer ends.
MAX_OFFER_S = OFFER_S + 1
# Time without a heartbeat after which an operator counts as away.
AWAY_AFTER_S = 10.0
# Minimum interval between two plans.
PLAN_EVERY_S = 0.5
# Time after passing a request in which its user is not offered it again.
PASSED_FOR_S = 60.0
# Time after closing a request in which its operator gets no other.
WRAP_UP_S = 30.0

OperatorState = Literal["available", "busy", "away", "wrap_up"]


@dataclass(frozen=True)
class WaitingRequest:
    """A request that nobody has accepted yet, whether it is offered or not.

    `priority` is 1 (urgent) to 3 (low); `pool` "" admits every operator; `since` is when it was made;
    `passed_by` has when each user declined it last or let its offer end.
    """

    id: int
    robot_id: int
    priority: int
    pool: str
    since: float
    passed_by: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Offer:
    """A request that a user alone may accept until a time."""

    request_id: int
    user_id: int
    until: float


@dataclass(frozen=True)
class Operator:
    """A user at the queue, and the robots that this user has the right to drive."""

    user_id: int
    state: OperatorState
    idle_since: float
    pools: frozenset[str]
    may_drive: frozenset[int]

    def may_take(self, request: WaitingRequest) -> bool:
        """Return whether right and pool fit."""
        return request.robot_id in self.may_drive and request.pool in ("", *self.pools)


@dataclass(frozen=True)
class QueueState:
    """All that a plan depends on, at the time `now`."""

    now: float
    waiting: tuple[WaitingRequest, ...]
    offers: tuple[Offer, ...]
    operators: tuple[Operator, ...]


@dataclass(frozen=True)
class Plan:
    """Offers that end, which their users have thereby passed, and offers that begin."""

    end: tuple[Offer, ...]
    offer: tuple[Offer, ...]


def plan(state: QueueState) -> Plan:
    """Return which offers end and which begin.

    The most urgent request comes first, then the oldest. Of the users who are available, have right and
    pool, and have not passed it, it goes to one of the fewest pools, so that those of more stay free for
    what they alone may take; of these, to the longest idle. Requests that are left go to users who passed
    them over PASSED_FOR_S ago, the request that was passed longest ago first: so each comes round again.
    """
    lasting = _lasting_offers(state)
    end = tuple(offer for offer in state.offers if offer not in lasting.values())
    users = sorted(
        (
            user
            for user in state.operators
            if user.state == "available" and user.user_id not in lasting
        ),
        key=lambda user: (len(user.pools), user.idle_since, user.user_id),
    )
    offered = {offer.request_id for offer in lasting.values()}
    requests = sorted(
        (
            _with_passes(request, end, state.now)
            for request in state.waiting
            if request.id not in offered
        ),
        key=lambda request: (request.priority, request.since, request.id),
    )
    pairs = _pair(requests, users)
    again = sorted(
        (request for request in requests if request.id not in pairs),
        key=lambda request: max(request.passed_by.values(), default=state.now),
    )
    pairs |= _pair([_without_old_passes(request, state.now) for request in again], users)
    return Plan(end, tuple(Offer(*pair, until=state.now + OFFER_S) for pair in pairs.items()))


def _lasting_offers(state: QueueState) -> dict[int, Offer]:
    """Return the offers that stay, by user: one a request, one a user, in their time, within the right to drive.

    The pool is not checked, as a supervisor may assign a request to a user of another.
    """
    users = {user.user_id: user for user in state.operators if user.state == "available"}
    robots = {request.id: request.robot_id for request in state.waiting}
    lasting: dict[int, Offer] = {}
    for offer in sorted(
        state.offers, key=lambda offer: (offer.until, offer.request_id, offer.user_id)
    ):
        user, robot_id = users.get(offer.user_id), robots.get(offer.request_id)
        is_on_time = state.now < offer.until <= state.now + MAX_OFFER_S
        if is_on_time and user and robot_id in user.may_drive:
            lasting[users.pop(user.user_id).user_id] = offer
            del robots[offer.request_id]
    return lasting


def _with_passes(request: WaitingRequest, end: tuple[Offer, ...], now: float) -> WaitingRequest:
    """Return the request as passed by those whose offer of it ends now."""
    passes = {offer.user_id: now for offer in end if offer.request_id == request.id}
    return replace(request, passed_by={**request.passed_by, **passes})


def _without_old_passes(request: WaitingRequest, now: float) -> WaitingRequest:
    """Return the request without old passes, and those of a clock that has been set back since."""
    passes = request.passed_by.items()
    newest = {user_id: at for user_id, at in passes if 0 <= now - at < PASSED_FOR_S}
    return replace(request, passed_by=newest)


def _pair(requests: list[WaitingRequest], users: list[Operator]) -> dict[int, int]:
    """Return the user of each request, in order; `users` loses them."""
    pairs = {}
    for request in requests:
        for user in users:
            if user.may_take(request) and user.user_id not in request.passed_by:
                pairs[request.id] = user.user_id
                users.remove(user)
                break
    return pairs
