"""The model of one direction of an emulated link."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_queue import Direction, Shape

PACKET = bytes(1000)


def direction(**shape: object) -> Direction:
    return Direction(Shape(**shape), Random(1))


def arrivals(way: Direction, until: float) -> list[float]:
    """When packets arrive, asked at exactly the moments that the model names."""
    found = []
    while (at := way.next_at()) is not None and at <= until:
        found += [at for _ in way.due(at)]
    return found


def test_packets_leave_at_the_rate_and_arrive_after_the_delay() -> None:
    """1000 bytes at 8 Mbit/s take 1 ms each."""
    way = direction(rate_bit_s=8e6, delay_s=0.02)
    for _ in range(3):
        way.offer(10.0, PACKET)
    assert arrivals(way, 11) == pytest.approx([10.021, 10.022, 10.023])


def test_what_finds_the_queue_full_is_dropped() -> None:
    """Drop tail, counted in bytes, with the packet on the wire included."""
    way = direction(rate_bit_s=8e6, queue_bytes=2500)
    for _ in range(4):
        way.offer(0.0, PACKET)
    assert len(arrivals(way, 1)) == 2
    assert way.counts.overflowed == 2
    assert way.counts.most_queued_bytes == 2000


def test_a_new_rate_holds_for_what_waits() -> None:
    """The packet on the wire goes on with what is left of it."""
    way = direction(rate_bit_s=8e6)
    way.offer(0.0, PACKET)
    way.offer(0.0, PACKET)
    way.change(0.0005, Shape(rate_bit_s=4e6))
    assert arrivals(way, 1) == pytest.approx([0.0015, 0.0035])


def test_an_unlimited_link_can_become_a_slow_one() -> None:
    """What left already is not held back, what comes is."""
    way = direction()
    way.offer(0.0, PACKET)
    way.change(0.0, Shape(rate_bit_s=8e6))
    way.offer(0.0, PACKET)
    assert arrivals(way, 1) == pytest.approx([0.0, 0.001])


def test_a_blackhole_swallows_what_is_on_the_way_too() -> None:
    """Nothing arrives until it ends, and then only what came after."""
    way = direction(delay_s=0.01)
    way.offer(0.0, PACKET)
    way.change(0.005, Shape(delay_s=0.01, blackhole=True))
    way.offer(0.006, PACKET)
    assert arrivals(way, 1) == []
    way.change(2.0, Shape(delay_s=0.01))
    way.offer(2.0, PACKET)
    assert arrivals(way, 3) == pytest.approx([2.01])
    assert way.counts.swallowed == 2


def test_loss_is_random_and_the_same_again_with_the_same_seed() -> None:
    """About one in ten, never a matter of chance between two runs."""

    def lost() -> int:
        way = direction(loss=0.1)
        for _ in range(5000):
            way.offer(0.0, PACKET)
        return way.counts.lost

    assert 400 < lost() < 600
    assert lost() == lost()


@given(st.lists(st.floats(0, 1), min_size=1, max_size=50), st.floats(0, 0.05))
def test_order_is_kept_whatever_the_jitter(times: list[float], jitter_s: float) -> None:
    """A packet never overtakes, and each is at most `jitter_s` off or held up by the one before it."""
    way = direction(delay_s=0.05, jitter_s=jitter_s)
    for number, at in enumerate(sorted(times)):
        way.offer(at, bytes([number]))
    seen = list(way.due(100.0))
    assert seen == [bytes([number]) for number in range(len(times))]
