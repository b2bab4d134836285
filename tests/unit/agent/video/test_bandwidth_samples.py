"""What a stretch of looks at a connection says of its path."""

from __future__ import annotations

import pytest
from robotether_agent.video.bandwidth_samples import (
    MIN_BURST_SEGMENTS,
    MIN_ROUND_S,
    SEEN_LATE_S,
    Burst,
    Round,
)
from robotether_agent.video.connection_state import Reading

SEGMENT = 1448
RTT_S = 0.04
PICTURE = 20 * SEGMENT


def look(at_s: float, written: int, arrived: int, rtt_s: float = RTT_S) -> Reading:
    return Reading(at_s, written, arrived, rtt_s, RTT_S, SEGMENT)


def test_a_round_is_over_when_all_has_arrived_that_was_in_flight() -> None:
    """And not before the time of a round trip, or of a round that says something."""
    seen = Round(look(0, 5000, 2000))
    seen.add(look(MIN_ROUND_S / 2, 9000, 5000), was_full=True)
    assert not seen.is_over
    seen.add(look(MIN_ROUND_S, 9000, 4999), was_full=True)
    assert not seen.is_over
    seen.add(look(2 * MIN_ROUND_S, 9000, 5000), was_full=True)
    assert seen.is_over
    assert seen.rate == pytest.approx(3000 / (2 * MIN_ROUND_S))


def test_a_round_weighs_round_trips_by_their_time() -> None:
    """A quarter of the time at 80 ms, the rest at 40."""
    seen = Round(look(0, 0, 0))
    seen.add(look(0.01, 0, 0, 0.08), was_full=False)
    seen.add(look(0.04, 0, 0, 0.04), was_full=False)
    assert seen.rtt_s == pytest.approx(0.05)
    assert seen.jitter_s == pytest.approx(0.0173, abs=1e-4)


@pytest.mark.parametrize(("waited_s", "was_full"), [(0.07, False), (0.09, True)])
def test_a_round_was_full_when_somebody_waited_for_most_of_it(
    waited_s: float, was_full: bool
) -> None:
    seen = Round(look(0, 0, 0))
    seen.add(look(waited_s, 0, 0), was_full=True)
    seen.add(look(0.1, 0, 0), was_full=False)
    assert seen.was_full is was_full


def test_a_frame_counts_from_its_first_byte_to_its_last_ones_arrival() -> None:
    """Not from the look before that, and without the round trip; what is written after it is another one."""
    burst = Burst(look(0, 0, 0))
    burst.add(look(1, 0, 0), is_handed=True)
    burst.add(look(1.01, PICTURE // 2, 0), is_handed=False)
    burst.add(look(1.02, PICTURE, 0), is_handed=True)
    burst.add(look(1.03, 2 * PICTURE, 0), is_handed=True)
    assert not burst.has_arrived(look(1.05, 2 * PICTURE, PICTURE - 1))
    last = look(1.1, 2 * PICTURE, PICTURE)
    assert burst.has_arrived(last)
    assert burst.rate(last) == pytest.approx(PICTURE / (0.1 - RTT_S - SEEN_LATE_S))


def test_a_frame_that_seems_to_take_no_time_took_the_time_between_two_looks() -> None:
    burst = Burst(look(0, 0, 0))
    burst.add(look(0.01, PICTURE, 0), is_handed=True)
    assert burst.rate(look(RTT_S, PICTURE, PICTURE)) == pytest.approx(PICTURE / SEEN_LATE_S)


def test_a_few_bytes_tell_nothing() -> None:
    little = MIN_BURST_SEGMENTS * SEGMENT - 1
    burst = Burst(look(0, 0, 0))
    burst.add(look(0.01, little, 0), is_handed=True)
    last = look(0.1, little, little)
    assert burst.has_arrived(last)
    assert burst.rate(last) is None


def test_a_reading_that_tells_too_little_delays_no_frame() -> None:
    burst = Burst(look(0, SEGMENT, SEGMENT))
    burst.add(look(0.5, SEGMENT - 100, SEGMENT), is_handed=True)
    burst.add(look(0.51, PICTURE, SEGMENT), is_handed=True)
    last = look(0.6, PICTURE, PICTURE)
    assert burst.has_arrived(last)
    assert burst.rate(last) == pytest.approx(
        (PICTURE - SEGMENT + 100) / (0.1 - RTT_S - SEEN_LATE_S)
    )
