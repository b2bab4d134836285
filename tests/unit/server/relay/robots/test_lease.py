"""Who drives, as rules: without network, clock and database."""

import contextlib
from datetime import timedelta

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from relay_server import ANN, BEN, CARL, utc
from robotether_server.problems import (
    NotPossibleError,
    RobotetherError,
    ThrottledError,
)
from robotether_server.relay.robots.connection import Connection
from robotether_server.relay.robots.lease import HeldError, Instant, Lease

NOON = utc(2026, 1, 1, 12, 0)


def connection_of(user, **kinds):
    return Connection(user.id, user.name, None, "drive", None, **kinds)


@pytest.fixture
def lease():
    return Lease()


def at(seconds):
    return Instant(seconds, NOON + timedelta(seconds=seconds))


def driven_by(user, lease, seconds=0.0):
    holder = connection_of(user)
    lease.claim(holder, at(seconds))
    assert lease.grant(holder, lease.fence + 1, at(seconds))
    return holder


def test_a_route_takes_nothing_that_is_a_persons_or_kept_for_one(lease):
    """Not even of its own maker, who in turn gets control of it by taking it alone."""
    driven_by(ANN, lease)
    with pytest.raises(HeldError):
        lease.claim(connection_of(ANN, is_route=True), at(0))
    lease.ask(BEN, at(0))
    lease.hand_over(ANN, at(0))
    with pytest.raises(HeldError):
        lease.claim(connection_of(BEN, is_route=True), at(1))
    route = connection_of(ANN, is_route=True)
    lease.claim(route, at(60))
    with pytest.raises(HeldError):
        lease.claim(connection_of(ANN), at(60))
    lease.grant(route, 2, at(60))
    assert lease.take(ANN, at(61)).driver.holder is route


def test_commands_of_a_route_are_no_answer_to_who_asks(lease):
    """Its maker may ask, too."""
    route = connection_of(ANN, is_route=True)
    lease.claim(route, at(0))
    driver = lease.grant(route, 1, at(0))
    assert lease.ask(ANN, at(5))
    driver.on_command(at(24))
    assert lease.pass_on(at(25)).to == ANN


def test_a_claim_that_got_no_number_leaves_the_older_connection(lease):
    """Without a database who drives drives on."""
    older = driven_by(ANN, lease)
    newer = connection_of(ANN)
    lease.claim(newer, at(1))
    lease.end(newer, at(2))
    assert lease.driver.holder is older


def test_a_number_that_is_not_newer_is_no_lease(lease):
    """What the guard would refuse is not granted."""
    lease.fence = 5
    holder = connection_of(ANN)
    lease.claim(holder, at(0))
    assert not lease.grant(holder, 5, at(0))
    assert lease.grant(holder, 6, at(0))


def test_the_control_passes_on_after_20_s_without_input(lease):
    """Each command puts it off; then it is kept for the asker for 10 s, and free afterwards."""
    holder = driven_by(ANN, lease)
    assert lease.ask(BEN, at(1))
    assert lease.passes_at() == at(21)
    lease.driver.on_command(at(15))
    assert lease.pass_on(at(34.9)) is None
    passed = lease.pass_on(at(35))
    assert (passed.driver.holder, passed.to) == (holder, BEN)
    assert lease.reserved(at(44.9)).user == BEN
    with pytest.raises(HeldError):
        lease.claim(connection_of(ANN), at(40))
    lease.claim(connection_of(BEN), at(40))
    assert lease.reserved(at(45)) is None


def test_a_driver_is_not_asked_again_and_again(lease):
    driven_by(ANN, lease)
    for second in range(3):
        assert lease.ask(BEN, at(second))
        assert not lease.ask(BEN, at(second))
        assert lease.refuse(ANN, at(second)) == BEN
        assert lease.passes_at() is None
    with pytest.raises(ThrottledError, match="ask again in 28 s") as throttled:
        lease.ask(BEN, at(2))
    assert throttled.value.retry_after_s == 28
    assert lease.request is None
    assert lease.ask(CARL, at(3))
    lease.withdraw(CARL)
    assert lease.ask(BEN, at(30))
    lease.withdraw(BEN)
    with pytest.raises(ThrottledError):
        lease.ask(BEN, at(59))


def test_what_is_kept_for_a_manager_is_not_taken_again(lease):
    driven_by(ANN, lease)
    lease.take(BEN, at(0))
    assert lease.take(BEN, at(9)) is None
    with pytest.raises(HeldError):
        lease.claim(connection_of(CARL), at(9.9))
    assert lease.reserved(at(10)) is None
    driven_by(CARL, lease, 10)
    for other in ("ann", "carl (route)"):
        with pytest.raises(NotPossibleError, match="another user has it"):
            lease.take(BEN, at(12), other)
    lease.take(BEN, at(12), "carl")
    with pytest.raises(NotPossibleError, match="another user has it"):
        lease.take(ANN, at(13), "carl")
    assert lease.take(ANN, at(13)).to == ANN


def test_who_waits_is_next_when_the_driver_leaves():
    """The waiting user is next even if the driver's next connection got no number."""
    lease = Lease()
    holder = driven_by(ANN, lease)
    lease.ask(BEN, at(0))
    lease.end(holder, at(1))
    assert lease.reserved(at(2)).user == BEN
    lease = Lease()
    older = driven_by(ANN, lease)
    lease.ask(BEN, at(0))
    newer = connection_of(ANN)
    lease.claim(newer, at(1))
    lease.end(older, at(2))
    assert lease.reserved(at(2)) is None
    lease.end(newer, at(3))
    assert lease.reserved(at(4)).user == BEN


def test_without_the_right_nothing_is_kept(lease):
    driven_by(ANN, lease)
    lease.take(BEN, at(1))
    assert not lease.keep_only(lambda user_id: user_id == BEN.id)
    assert lease.reserved(at(1)).user == BEN
    assert lease.keep_only(lambda user_id: user_id != BEN.id)
    lease.claim(connection_of(CARL), at(2))


def test_a_free_lease_is_kept_for_who_is_to_help(lease):
    assert lease.reserve(BEN, at(20), at(0))
    assert not lease.reserve(BEN, at(20.5), at(1))
    with pytest.raises(HeldError):
        lease.claim(connection_of(ANN), at(20))
    assert lease.take(CARL, at(2)).to == CARL
    assert not lease.reserve(BEN, at(20), at(3))
    assert not lease.reserve(None, at(3), at(3))
    assert lease.reserved(at(3)).user == CARL
    assert lease.reserve(BEN, at(40), at(12))
    lease.claim(connection_of(BEN), at(13))
    lease.revoke()
    assert lease.reserve(BEN, at(40), at(14))
    assert lease.reserve(None, at(14), at(14))
    lease.claim(connection_of(ANN), at(15))


def test_who_drives_or_is_about_to_comes_before_who_is_to_help(lease):
    lease.claim(connection_of(ANN), at(0))
    assert not lease.reserve(BEN, at(20), at(1))
    holder = driven_by(ANN, lease, 2)
    assert not lease.reserve(BEN, at(20), at(3))
    lease.ask(CARL, at(4))
    lease.end(holder, at(5))
    assert not lease.reserve(BEN, at(20), at(6))
    assert lease.reserved(at(6)).user == CARL


class LeaseMachine(RuleBasedStateMachine):
    """Whatever people do and in whatever order: one driver, and numbers that grow."""

    def __init__(self):
        super().__init__()
        self.lease = Lease()
        self.now = at(0)
        self.claimed = []
        self.open = set()
        self.database = 0
        self.granted = []

    users = st.sampled_from([ANN, BEN, CARL])

    @rule(seconds=st.floats(0.1, 15))
    def time_passes(self, seconds):
        self.now = self.now.later(seconds)
        passed = self.lease.pass_on(self.now)
        if passed is not None:
            self.open.discard(passed.driver.holder)

    @rule(user=users)
    def connect(self, user):
        holder = connection_of(user)
        with contextlib.suppress(HeldError):
            older = self.lease.claim(holder, self.now)
            assert older is None or older.user_id == user.id
            self.database += 1
            self.claimed.append((holder, self.database))

    @rule(index=st.integers(0, 5))
    def database_answers(self, index):
        """Answers may come in any order, and late."""
        if self.claimed:
            holder, fence = self.claimed.pop(index % len(self.claimed))
            if self.lease.grant(holder, fence, self.now):
                self.granted.append(fence)
                assert {older.user_id for older in self.open} <= {holder.user_id}
                self.open = {holder}

    @rule(user=users)
    def disconnect(self, user):
        for holder in [holder for holder in self.open if holder.user_id == user.id]:
            self.open.discard(holder)
            self.lease.end(holder, self.now)

    @rule(user=users, action=st.sampled_from(["ask", "refuse", "hand_over", "take"]))
    def act(self, user, action):
        with contextlib.suppress(RobotetherError):
            result = getattr(self.lease, action)(user, self.now)
            if action in {"hand_over", "take"} and result is not None and result.driver is not None:
                self.open.discard(result.driver.holder)

    @rule(user=st.none() | users)
    def reserve(self, user):
        self.lease.reserve(user, self.now.later(5), self.now)

    @rule()
    def stop(self):
        self.open.discard(self.lease.revoke())

    @invariant()
    def one_driver_at_most(self):
        holder = self.lease.driver.holder if self.lease.driver else None
        assert self.open <= {holder}

    @invariant()
    def numbers_grow(self):
        assert self.granted == sorted(set(self.granted))
        assert self.lease.driver is None or self.lease.driver.fence == self.granted[-1]

    @invariant()
    def who_waits_has_somebody_to_wait_for(self):
        assert not (self.lease.request and self.lease.reserved(self.now))


TestLeaseMachine = LeaseMachine.TestCase
# Faults of claims and grants are found within 25.
TestLeaseMachine.settings = settings(max_examples=settings.default.max_examples // 2)
