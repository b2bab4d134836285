"""The allowance's sums, with a clock of the test's own."""

from __future__ import annotations

from robotether_server.relay.http.rate_limiter import RateLimiter


def taken(limiter: RateLimiter, now: float, tries: int) -> int:
    return sum(limiter.allow(now) for _ in range(tries))


def test_so_many_at_once_and_no_more():
    """A full allowance is used up at once."""
    assert taken(RateLimiter(0.0, per_s=10, at_once=5), 0.0, 100) == 5


def test_it_fills_again_with_time():
    """After a while there is as much as the rate gives, and never more than at first."""
    limiter = RateLimiter(0.0, per_s=10, at_once=5)
    assert taken(limiter, 0.0, 100) == 5
    assert taken(limiter, 0.25, 100) == 2
    assert taken(limiter, 60.0, 100) == 5


def test_a_steady_use_below_the_rate_is_never_refused():
    """Who keeps to the average has no need of the reserve."""
    limiter = RateLimiter(0.0, per_s=10, at_once=2)
    assert all(limiter.allow(step / 9) for step in range(1000))


def test_trying_in_vain_costs_nothing():
    """Refusals do not delay the next success."""
    limiter = RateLimiter(0.0, per_s=1, at_once=1)
    assert taken(limiter, 0.0, 1000) == 1
    assert limiter.allow(1.0)


def test_something_may_count_more_than_once():
    """It takes as much as it counts, or nothing."""
    limiter = RateLimiter(0.0, per_s=1, at_once=10)
    assert limiter.allow(0.0, 7)
    assert not limiter.allow(0.0, 4)
    assert limiter.allow(0.0, 3)


def test_it_says_when_it_may_be_used_again():
    """At once, or when enough has filled again."""
    limiter = RateLimiter(0.0, per_s=0.5, at_once=2)
    assert limiter.free_in_s(0.0) == 0
    assert taken(limiter, 0.0, 2) == 2
    assert limiter.free_in_s(0.0) == 2
    assert limiter.free_in_s(1.5) == 0.5
    assert not limiter.allow(1.5)
    assert limiter.allow(2.0)
