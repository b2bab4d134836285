"""What guards refused, as differences."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from robotether_server.relay.guard_counts import GuardCounts


def test_the_first_word_of_a_robot_is_where_counting_begins():
    """Robots do not share their counts, and one that was forgotten begins again."""
    counts = GuardCounts()
    assert counts.new_refusals(7, [("old", 5), ("held", 1)]) == {}
    assert counts.new_refusals(7, [("old", 7), ("held", 1)]) == {"old": 2}
    assert counts.new_refusals(8, [("old", 9)]) == {}
    counts.keep_only([8])
    assert counts.new_refusals(7, [("old", 9), ("held", 1)]) == {}
    assert counts.new_refusals(8, [("old", 10)]) == {"old": 1}


def test_a_guard_that_began_anew_is_counted_from_nothing():
    """Also when only one of its counts shows it."""
    counts = GuardCounts()
    counts.new_refusals(7, [("old", 5), ("held", 1)])
    assert counts.new_refusals(7, [("old", 0), ("held", 3)]) == {"held": 3}


def test_a_guard_that_tells_no_counts_changes_nothing():
    """As one from before they were told."""
    counts = GuardCounts()
    counts.new_refusals(7, [("old", 5)])
    assert counts.new_refusals(7, []) == {}
    assert counts.new_refusals(7, [("old", 6)]) == {"old": 1}


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 9)), max_size=20))
def test_of_what_is_refused_nothing_is_counted_twice(steps):
    """Guards that begin anew tell so first, as they do."""
    counts, refused, found, reported = GuardCounts(), 0, 0, 0
    counts.new_refusals(7, [("old", 0)])
    for anew, more in steps:
        if anew:
            reported = 0
            found += counts.new_refusals(7, [("old", reported)])["old"]
        reported, refused = reported + more, refused + more
        found += counts.new_refusals(7, [("old", reported)])["old"]
    assert found == refused
