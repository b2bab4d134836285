"""Properties of every plan, and of queues that are planned again and again."""

from collections import Counter
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
from robotether_server.services.planning import (
    MAX_OFFER_S,
    OFFER_S,
    PASSED_FOR_S,
    Offer,
    Operator,
    QueueState,
    WaitingRequest,
    plan,
)

NOW = 1000.0
IDS = range(1, 6)
POOLS = ("", "arms", "wheels")
ids = st.sampled_from(IDS)
times = st.sampled_from([NOW - PASSED_FOR_S, NOW - 20, NOW - 10, NOW])

requests = st.builds(
    WaitingRequest,
    id=ids,
    robot_id=st.sampled_from([1, 2]),
    priority=st.sampled_from([1, 2, 3]),
    pool=st.sampled_from(POOLS),
    since=times,
    passed_by=st.dictionaries(ids, times),
)
operators = st.builds(
    Operator,
    user_id=ids,
    state=st.sampled_from(["available", "available", "busy", "away", "wrap_up"]),
    idle_since=times,
    pools=st.frozensets(st.sampled_from(POOLS[1:])),
    may_drive=st.frozensets(st.sampled_from([1, 2])),
)
offers = st.builds(
    Offer, request_id=ids, user_id=ids, until=st.sampled_from([NOW - 1, NOW, NOW + 9, NOW + 3600])
)
states = st.builds(
    QueueState,
    now=st.just(NOW),
    waiting=st.lists(requests, unique_by=lambda request: request.id).map(tuple),
    offers=st.lists(offers, unique=True).map(tuple),
    operators=st.lists(operators, unique_by=lambda operator: operator.user_id).map(tuple),
)


class Planned:
    """A state and its plan, by what they say of each request and user."""

    def __init__(self, state):
        self.state, self.plan = state, plan(state)
        self.kept = [offer for offer in state.offers if offer not in self.plan.end]
        self.offers = [*self.kept, *self.plan.offer]
        self.requests = {request.id: request for request in state.waiting}
        self.operators = {
            user.user_id: user for user in state.operators if user.state == "available"
        }
        self.users = {offer.request_id: self.operators[offer.user_id] for offer in self.plan.offer}

    def free(self):
        """Who has no offer after the plan."""
        return [
            user
            for user in self.operators.values()
            if user.user_id not in {offer.user_id for offer in self.offers}
        ]

    def passed_at(self, request, user):
        ended = any(
            (offer.request_id, offer.user_id) == (request.id, user.user_id)
            for offer in self.plan.end
        )
        return NOW if ended else request.passed_by.get(user.user_id, 0.0)

    def has_passed(self, request, user):
        return self.passed_at(request, user) > 0.0

    def may_get(self, request, user):
        return user.may_take(request) and NOW - self.passed_at(request, user) >= PASSED_FOR_S


def has_one_offer_each(after):
    assert max(Counter(offer.request_id for offer in after.offers).values(), default=1) == 1
    assert max(Counter(offer.user_id for offer in after.offers).values(), default=1) == 1
    assert all(offer.until == NOW + OFFER_S for offer in after.plan.offer)


def offers_by_right_and_pool(after):
    for offer in after.offers:
        assert after.requests[offer.request_id].robot_id in after.operators[offer.user_id].may_drive
    for offer in after.plan.offer:
        request, user = after.requests[offer.request_id], after.operators[offer.user_id]
        assert request.pool == "" or request.pool in user.pools


def ends_offers_for_a_reason(after):
    """A plan takes nothing from an operator who may still accept it."""
    # A database's clock that was set back must not hold up a request for an hour.
    assert all(NOW < offer.until <= NOW + MAX_OFFER_S for offer in after.kept)
    for offer in after.plan.end:
        user, request = after.operators.get(offer.user_id), after.requests.get(offer.request_id)
        others = {(other.request_id, other.user_id) for other in after.kept}
        assert (
            offer.until <= NOW
            or offer.until > NOW + MAX_OFFER_S
            or user is None
            or request is None
            or request.robot_id not in user.may_drive
            or any(offer.request_id == other[0] or offer.user_id == other[1] for other in others)
        )


def leaves_nothing_waiting(after):
    """Nothing waits while an eligible operator is free."""
    offered = {offer.request_id for offer in after.offers}
    waiting = [request for request in after.state.waiting if request.id not in offered]
    assert not [
        (request, user)
        for request in waiting
        for user in after.free()
        if after.may_get(request, user)
    ]


def offers_urgent_and_old_requests_first(after):
    """No request has an operator whom a more urgent or older one could have had, unless that one passed it."""
    waiting = after.state.waiting
    order = {request.id: (request.priority, request.since, request.id) for request in waiting}
    offered = {offer.request_id for offer in after.offers}
    for request in waiting:
        for other, user in after.users.items():
            fresh = user.may_take(request) and not after.has_passed(request, user)
            assert request.id in offered or not fresh or order[other] < order[request.id]


def asks_the_fewest_pools_and_longest_idle_first(after):
    """A free operator has more pools than the one who got the request, was idle for less time, or has passed it."""
    for request_id, chosen in after.users.items():
        request = after.requests[request_id]
        for user in after.free():
            if after.may_get(request, user) and after.has_passed(request, user) <= after.has_passed(
                request, chosen
            ):
                assert order_of(chosen) < order_of(user)


def order_of(user):
    return len(user.pools), user.idle_since, user.user_id


@given(states)
def test_each_plan_keeps_to_the_rules(state):
    after = Planned(state)
    has_one_offer_each(after)
    offers_by_right_and_pool(after)
    ends_offers_for_a_reason(after)
    leaves_nothing_waiting(after)
    offers_urgent_and_old_requests_first(after)
    asks_the_fewest_pools_and_longest_idle_first(after)


@given(states, st.randoms())
def test_a_plan_depends_on_nothing_but_the_state(state, random):
    """The order of rows that a database returns is no part of it."""

    def shuffled(rows):
        return tuple(random.sample(rows, len(rows)))

    mixed = replace(
        state,
        waiting=shuffled(state.waiting),
        offers=shuffled(state.offers),
        operators=shuffled(state.operators),
    )
    assert plan(mixed).offer == plan(state).offer
    assert set(plan(mixed).end) == set(plan(state).end)


@given(st.lists(requests, unique_by=lambda request: request.id), st.integers(1, 3))
def test_requests_that_nobody_accepts_come_round_again(waiting, people):
    """However often an urgent request is passed, each other one is offered as often."""
    everything = {"pools": frozenset(POOLS), "may_drive": frozenset({1, 2})}
    users = tuple(Operator(user, "available", NOW, **everything) for user in range(people))
    passes = {request.id: {} for request in waiting}
    counts = Counter()
    for turn in range(3 * len(waiting)):
        now = NOW + turn * (OFFER_S + PASSED_FOR_S)
        requests = (replace(request, passed_by=dict(passes[request.id])) for request in waiting)
        for offer in plan(QueueState(now, tuple(requests), (), users)).offer:
            counts[offer.request_id] += 1
            passes[offer.request_id][offer.user_id] = now + 1
    assert all(counts[request.id] >= 3 for request in waiting)
