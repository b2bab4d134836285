"""What ssh was handed and has not written, and how fast it is handed more."""

from __future__ import annotations

from robotether_agent.video.connection_state import Reading
from robotether_agent.video.token_bucket import SAVED_S, STUCK_AFTER_S, TokenBucket, UnwrittenBytes


def at(at_s: float, written: int) -> Reading:
    return Reading(at_s, written, 0, 0.04, 0.04, 1448)


def test_handed_bytes_leave_when_ssh_wrote_them() -> None:
    """It writes a little more than it was handed, which must not become a debt."""
    handed = UnwrittenBytes()
    assert handed.left(at(0, 100)) == 0
    handed.add(1000)
    assert handed.left(at(0.01, 500)) == 600
    assert handed.left(at(0.02, 1150)) == 0
    handed.add(1000)
    assert handed.left(at(0.03, 1150)) == 1000


def test_bytes_that_ssh_cannot_write_are_forgotten() -> None:
    """They are stuck at a viewer who takes nothing."""
    handed = UnwrittenBytes()
    handed.left(at(0, 100))
    handed.add(1000)
    assert handed.left(at(STUCK_AFTER_S - 0.01, 100)) == 1000
    assert handed.left(at(STUCK_AFTER_S + 0.01, 100)) == 0


def test_a_bucket_fills_with_time() -> None:
    """Also over a late look, while somebody waits."""
    bucket = TokenBucket(5.0, 0)
    assert bucket.fill(5.25, 4000, has_waited=True, least=0) == 1000
    bucket.consume(800)
    assert bucket.fill(5.5, 4000, has_waited=True, least=0) == 1200


def test_a_bucket_keeps_little_that_nobody_wanted() -> None:
    """A frame after a pause is no burst of all that could have gone meanwhile."""
    bucket = TokenBucket(5.0, 0)
    assert bucket.fill(9.0, 100_000, has_waited=False, least=0) == int(100_000 * SAVED_S)
    assert bucket.fill(99.0, 100, has_waited=False, least=2048) == 2048
